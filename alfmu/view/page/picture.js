// Base of the moving pictures of live pages, in the plane and in space. Entries {"#": i} of `about.picture` depend on
// parameters: `shape` replaces them by numbers of the page's function `geometry`. `draw` takes a row of outputs.

const TRAIL = 600; // largest number of points of a trail

function resolved(of, numbers) {
  if (Array.isArray(of)) return of.map((each) => resolved(each, numbers));
  if (of === null || typeof of !== "object") return of;
  if ("#" in of) return numbers[of["#"]];
  return Object.fromEntries(Object.entries(of).map(([name, each]) => [name, resolved(each, numbers)]));
}

class Picture {
  constructor(canvas, about) {
    Object.assign(this, { canvas, about, names: false });
    this.forget();
  }

  // Read the present colours of the page.
  palette() {
    const style = getComputedStyle(this.canvas), names = ["ink", "faint", "steel", "white", "grid", "zero", "paper", "accent"];
    const colors = names.map((name) => [name, style.getPropertyValue("--" + name).trim()]);
    return { ...Object.fromEntries(colors), rim: Number(style.getPropertyValue("--rim")) };
  }

  // Adapt the canvas to its size on the page; return whether it changed.
  resized() {
    const size = [this.canvas.clientWidth, this.canvas.clientHeight, devicePixelRatio];
    const other = String(size) !== String(this.measured);
    this.measured = size;
    [this.width, this.height] = size;
    return other;
  }

  // Remove the trails when a run begins.
  forget() { this.trails = this.about.dots.map(() => []); }

  remember(row) {
    this.about.dots.forEach((name, i) => {
      const trail = this.trails[i];
      trail.push(this.about.frames[name].columns.map((c) => row[c]));
      if (trail.length > TRAIL) trail.shift();
    });
  }
}

// Return 1, 2 or 5 times a power of ten, at least the given value.
function nice(wanted) {
  const power = 10 ** Math.floor(Math.log10(wanted));
  return [1, 2, 5, 10].map((m) => m * power).find((x) => x >= wanted * (1 - 1e-9));
}
