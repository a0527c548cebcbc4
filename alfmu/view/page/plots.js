// Plots of the run over time, by uPlot.

const panels = [];

const LEAST = -18; // decimal exponent of the smallest error shown

const DASHES = [undefined, [9, 5], [2, 4], [12, 4, 2, 4]]; // of successive curves, which may coincide

class Panel {
  constructor(groups, chosen) {
    this.groups = groups;
    this.box = document.createElement("div");
    this.box.className = "panel";
    if (groups.length > 1) {
      const select = document.createElement("select");
      select.setAttribute("aria-label", "What this plot shows");
      groups.forEach((g, i) => select.add(new Option(g.title, i, i === chosen, i === chosen)));
      select.addEventListener("change", () => { this.choose(groups[select.value]); update(); });
      this.box.append(select);
    } else {
      const title = document.createElement("h2");
      title.textContent = groups[0].title;
      this.box.append(title);
    }
    this.drawing = document.createElement("div");
    this.box.append(this.drawing);
    find("plots").append(this.box);
    this.choose(groups[chosen]);
    new ResizeObserver(() => this.size()).observe(this.box);
  }

  choose(group) {
    this.group = group;
    this.columns = group.names.map((name) => place.get(name));
    if (this.plot) this.plot.destroy();
    const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue(name).trim();
    const axis = { stroke: color("--soft"), grid: { stroke: color("--grid"), width: 1 }, ticks: { stroke: color("--grid"), width: 1 },
      font: "12px system-ui, sans-serif" };
    const dark = document.documentElement.dataset.theme === "dark";
    const lines = dark ? about.colors : ["#3572ad", "#b9770e", "#2f8a57", "#b8452f", "#6b57b0", "#14808a", "#a8487c", "#68737e"];
    this.plot = new uPlot({
      width: 300,
      height: 190,
      pxAlign: 0,
      cursor: { drag: { x: false, y: false } },
      scales: {
        x: { time: false, range: () => this.range() },
        y: {
          range: (u, low, high) => {
            if (low === null) return group.log ? [LEAST, 0] : [-1, 1];
            if (group.log) return [Math.floor(low) - 0.3, Math.max(Math.ceil(high), Math.floor(low) + 3) + 0.3];
            const room = Math.max(0.08 * (high - low), 1e-3 * Math.max(Math.abs(low), Math.abs(high)), 1e-9);
            return [low - room, high + room];
          },
        },
      },
      axes: [{ ...axis, label: "s", labelSize: 14, labelFont: "12px system-ui, sans-serif", size: 28 },
        { ...axis, size: 62, ...(group.log ? { incrs: [1, 2, 3, 4, 6] } : {}),
          values: (u, marks) => marks.map((x) => (group.log ? `1e${x}` : tidy(x))) }],
      // The legend shows values at the cursor, or the last ones.
      series: [{ label: "t", value: (u, x, i, at) => `${(at === null ? u.data[0].at(-1) ?? 0 : x).toFixed(2)} s` },
        ...group.names.map((name, i) => ({
          label: group.labels[i],
          stroke: lines[i % lines.length],
          width: 1.8,
          dash: DASHES[i % DASHES.length],
          value: (u, x, which, at) => {
            const value = at === null ? u.data[which].at(-1) : x;
            return value === null || value === undefined ? "-" : brief(group.log ? 10 ** value : value);
          },
        }))],
    }, [[], ...group.names.map(() => [])], this.drawing);
    const canvas = this.drawing.querySelector("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Plot over time: ${group.title}`);
    this.size();
  }

  range() {
    const end = Math.max(run.now, WINDOW);
    return [end - WINDOW, end];
  }

  size() {
    const width = Math.floor(this.box.clientWidth - 24);
    if (this.plot && width > 50 && width !== this.width) this.plot.setSize({ width, height: 190 });
  }

  // Plot the rows up to the one with this index.
  show(index) {
    const from = run.rows[index].time - WINDOW;
    let first = index;
    while (first > 0 && run.rows[first].time > from) first -= 1;
    const count = index - first + 1, every = Math.max(1, Math.ceil(count / 2000)), some = [];
    // Show every n-th row, always the same ones, so that curves do not flicker.
    for (let i = first; i <= index; i++) if (i % every === 0 || i === index) some.push(run.rows[i]);
    const shown = this.group.log ? (x) => Math.max(LEAST, Math.log10(x)) : (x) => x;
    const data = this.columns.map((c) => some.map(({ row }) => (Number.isFinite(row[c]) ? shown(row[c]) : null)));
    this.plot.setData([some.map(({ time }) => time), ...data]);
  }
}

const tidy = (x) => (x !== 0 && (Math.abs(x) >= 1e5 || Math.abs(x) < 1e-3) ? x.toExponential(0).replace("e+", "e") : String(Number(x.toPrecision(6))));

function makePanels() {
  panels.forEach((panel) => panel.box.remove());
  panels.length = 0;
  if (EMBEDDED) return;
  about.panels.forEach(({ groups, chosen }) => panels.push(new Panel(groups.map((g) => about.groups[g]), chosen)));
}
