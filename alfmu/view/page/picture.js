// What the moving pictures of live pages share, in the plane and in space. Data of `about.picture` with {"#": i} in place of a number
// follow the parameters: `shape` puts in the numbers that the page's function `geometry` gives. `draw` takes a row of outputs.

const TRAIL = 600; // places that a trail keeps

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

  // Colours as the page has them now.
  palette() {
    const style = getComputedStyle(this.canvas), names = ["ink", "faint", "steel", "white", "grid", "zero", "paper", "accent"];
    const colors = names.map((name) => [name, style.getPropertyValue("--" + name).trim()]);
    return { ...Object.fromEntries(colors), rim: Number(style.getPropertyValue("--rim")) };
  }

  // Whether the size of the canvas on the page is another one by now; the new one.
  resized() {
    const size = [this.canvas.clientWidth, this.canvas.clientHeight, devicePixelRatio];
    const other = String(size) !== String(this.measured);
    this.measured = size;
    [this.width, this.height] = size;
    return other;
  }

  // The mechanism begins anew.
  forget() { this.trails = this.about.dots.map(() => []); }

  remember(row) {
    this.about.dots.forEach((name, i) => {
      const trail = this.trails[i];
      trail.push(this.about.frames[name].columns.map((c) => row[c]));
      if (trail.length > TRAIL) trail.shift();
    });
  }
}

// 1, 2 or 5 times a power of ten, not below what is wanted.
function nice(wanted) {
  const power = 10 ** Math.floor(Math.log10(wanted));
  return [1, 2, 5, 10].map((m) => m * power).find((x) => x >= wanted * (1 - 1e-9));
}
