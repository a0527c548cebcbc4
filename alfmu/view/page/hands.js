// Pointer and keys: dragging of bodies, buttons, and the start of the page once it is complete.

const canvas = find("picture"), pointers = new Set();
let pulling = null;

const under = (event) => {
  const box = canvas.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
};

function grab(event) {
  const [x, y] = under(event), point = run.drawn && about.tied.length && run.ready ? picture.hit(run.drawn.row, x, y) : null;
  if (!point) return;
  const playing = run.playing;
  play(false);
  // Rates are zero, because the mechanism is held.
  const starts = ties([...run.drawn.exact.q], about.tie_parameters.map((p) => ("ref" in p ? values.get(p.ref) : p.value)));
  pulling = { point, playing, starts, to: [x, y], busy: false, moved: false };
  picture.grabbed = true;
  canvas.style.cursor = "grabbing";
}

// Assemble the mechanism again, with the dragged point nearest to the pointer.
async function pull(mine) {
  if (mine.busy || !mine.fresh || run.starting) return;
  const { point } = mine;
  mine.busy = true;
  mine.fresh = false;
  if (!mine.moved) {
    mine.moved = true;
    run.epoch += 1;
    run.asking = false;
    run.failed = run.warned = "";
    about.tied.forEach(({ rate }) => change(rate, 0));
  }
  const tied = new Set(about.tied.flatMap(({ value, rate }) => [value, rate]));
  const answer = await ask("pull", {
    values: given().filter(([reference]) => !tied.has(reference)),
    starts: mine.starts,
    target: mine.target,
    point: { x: point.x, y: point.y, references: point.columns.map((c) => about.shown[c]) },
  });
  mine.busy = false;
  mine.starts = answer.found || mine.starts;
  about.tied.forEach(({ value }, i) => change(value, mine.starts[i]));
  anew(answer);
  picture.pulled = pulling ? { ...point, to: mine.to } : null;
  pull(mine); // the pointer has moved meanwhile
  if (!mine.busy && mine.released) mine.released();
}

canvas.addEventListener("pointerdown", (event) => {
  if (event.button) return;
  if (!picture.metres) return;
  canvas.setPointerCapture(event.pointerId);
  pointers.add(event.pointerId);
  if (pointers.size === 1) grab(event);
});

canvas.addEventListener("pointermove", (event) => {
  const [x, y] = under(event);
  if (!pointers.has(event.pointerId)) {
    if (run.drawn && picture.metres) canvas.style.cursor = about.tied.length && picture.hit(run.drawn.row, x, y) ? "grab" : "default";
    return;
  }
  if (pulling) {
    pulling.to = [x, y];
    pulling.target = picture.metres(x, y);
    pulling.fresh = true;
    pull(pulling);
  }
});

function letGo(event) {
  pointers.delete(event.pointerId);
  if (!pulling) return;
  const mine = pulling;
  pulling = null;
  picture.pulled = null;
  picture.grabbed = false;
  canvas.style.cursor = "default";
  const go = () => {
    if (mine.moved) begin();
    if (mine.playing) play(true);
  };
  if (mine.busy) mine.released = go; else go();
}

canvas.addEventListener("pointerup", letGo);
canvas.addEventListener("pointercancel", letGo);

function toggleNames() {
  picture.names = !picture.names;
  find("names").setAttribute("aria-pressed", picture.names);
  update();
}

canvas.addEventListener("keydown", (event) => {
  const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
  const nearer = { "+": 1.15, "-": 1 / 1.15 }[event.key];
  if (!picture.stage || !(turns || nearer)) return;
  event.preventDefault();
  if (turns) picture.turn(...turns); else picture.nearer(nearer);
  update();
});

document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const { tagName, type } = event.target, typing = tagName === "INPUT" && type === "number";
  const pressed = ["BUTTON", "SELECT", "SUMMARY"].includes(tagName) || type === "checkbox";
  if (event.code === "Space" && !pressed && !typing) { event.preventDefault(); play(!run.playing); }
  if (typing || tagName === "SELECT") return;
  if (event.key === "r") again();
  if (event.key === ".") step();
  if (event.key === "n") toggleNames();
});

function again() {
  picture.refit();
  begin();
}

find("play").addEventListener("click", () => play(!run.playing));
find("step").addEventListener("click", step);
document.querySelectorAll(".reset").forEach((button) => button.addEventListener("click", again));
find("names").addEventListener("click", toggleNames);
find("save").addEventListener("click", () => save(csv(), `${about.name}.csv`));
find("inputs").addEventListener("click", () => save(csv((v) => v.kind === "input" || v.kind === "switch"), `${about.name}_inputs.csv`));
for (const speed of [0.05, 0.1, 0.25, 0.5, 1, 2, 5]) find("speed").add(new Option(`${speed} \u00d7`, speed, speed === 1, speed === 1));
find("speed").addEventListener("change", () => { run.speed = Number(find("speed").value); run.marks = []; });
find("theme").addEventListener("click", () => paint(document.documentElement.dataset.theme === "dark" ? "light" : "dark"));

function paint(theme) {
  document.documentElement.dataset.theme = theme;
  makePanels();
  update();
}

const darkness = matchMedia("(prefers-color-scheme: dark)");
darkness.addEventListener("change", () => paint(darkness.matches ? "dark" : "light"));

makeControls();
tellCommand();
shape();
paint(darkness.matches ? "dark" : "light");
new ResizeObserver(update).observe(canvas);
requestAnimationFrame(tick);
begin();
// The run starts at once, unless the reader prefers reduced motion.
if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);

// For the console, and for scripts that drive the page.
window.alfmu = {
  about,
  csv,
  play,
  step,
  begin: again,
  set(name, value) {
    const reference = variables.findIndex((v) => v.name === name);
    if (reference < 0 || variables[reference].kind === "output") throw new Error(`There is no input or parameter ${name}.`);
    change(reference, Number(value));
    if (!["input", "switch"].includes(variables[reference].kind)) begin();
  },
  // Run to a time [s] as fast as possible, and pause there.
  async run(until) {
    play(false);
    while (!run.failed && latest() < until - interval / 2) {
      if (run.asking || run.starting || !run.ready || !run.rows.length) await new Promise((go) => { setTimeout(go, 5); });
      else await advance(until);
    }
    run.now = latest();
    update();
    return this.state();
  },
  state: () => ({
    time: latest(), now: run.now, playing: run.playing, failed: run.failed, warned: run.warned, ready: run.ready,
    busy: Boolean(run.busy || run.starting || wanted || waiting.size), rows: run.rows.length,
  }),
};
