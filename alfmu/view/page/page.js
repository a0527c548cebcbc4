// The page: controls, the clock of the run, plots. The worker has the runtime, and this asks it for rows ahead of the clock.

const about = JSON.parse(document.getElementById("about").textContent);
const find = (id) => document.getElementById(id);
const { variables, interval } = about;
const place = new Map(about.shown.map((reference, column) => [variables[reference].name, column]));

const EMBEDDED = location.hash === "#embedded"; // in a frame of another page, as a picture that runs
document.documentElement.toggleAttribute("data-embedded", EMBEDDED);

const AHEAD = 0.05; // s of the clock that rows are asked for before they are shown
const BUDGET = 20; // ms of work between two answers of the worker, and one communication step at least
const SLOW = 2500; // ms after which a step is said to take long
const KEPT = 6e6; // numbers of the run that are kept, for plots and the table
const WINDOW = Math.min(10, about.stop_time); // s that plots show

const values = new Map(variables.map((v, reference) => [reference, v.start])); // what the controls say
const controls = new Map(); // by reference: what shows a value
const run = { rows: [], now: 0, playing: false, speed: 1, epoch: 0, busy: 0, failed: "", warned: "", ready: false, drawn: null };

// Talking to the worker ------------------------------------------------------------------------------------------------

let worker = null, asked = 0;
const waiting = new Map();

function ask(kind, message = {}, transfer = []) {
  return new Promise((answer) => {
    waiting.set(++asked, answer);
    worker.postMessage({ id: asked, kind, ...message }, transfer);
  });
}

async function bytes(id) {
  const packed = Uint8Array.from(atob(find(id).textContent.trim()), (c) => c.charCodeAt(0));
  const plain = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(plain).arrayBuffer());
}

// A worker with library and scene, in place of the one there is.
async function employ() {
  if (worker) worker.terminate();
  waiting.clear();
  run.busy = 0;
  run.ready = run.starting = false;
  const epoch = ++run.epoch;
  const [wasm, scene] = await Promise.all([bytes("wasm"), bytes("scene")]);
  if (epoch !== run.epoch) return;
  const code = URL.createObjectURL(new Blob([find("worker").textContent], { type: "text/javascript" }));
  worker = new Worker(code);
  worker.onmessage = ({ data }) => {
    const answer = waiting.get(data.id);
    waiting.delete(data.id);
    if (answer) answer(data);
  };
  worker.onerror = (event) => say(`This browser cannot run the page: ${event.message}`);
  const { n, shown, tied, interval: h } = about;
  const answer = await ask("load", { wasm, scene, about: { n, shown, tied, interval: h, count: variables.length } });
  if (answer.failed) say(answer.failed);
  await seen;
  run.ready = epoch === run.epoch && !answer.failed;
}

// The run ---------------------------------------------------------------------------------------------------------------

const pairs = (kinds) => variables.flatMap((v, reference) => (kinds.includes(v.kind) ? [[reference, values.get(reference)]] : []));
const inputs = () => pairs(["input", "switch"]);

// All that a start takes, but for what has its default.
const given = () => variables.flatMap((v, reference) => (
  v.kind === "output" || values.get(reference) === v.start ? [] : [[reference, values.get(reference)]]));

let wanted = null; // what to begin with once the worker is free

// Begin at time 0 with what the controls say.
function begin() {
  const late = run.busy && performance.now() - run.busy > SLOW;
  run.epoch += 1;
  run.failed = run.warned = "";
  run.asking = false;
  say("");
  wanted = () => start();
  if (late || !worker || !run.ready) employ().then(release); else release();
}

function release() {
  if (!wanted || !run.ready || run.starting) return;
  const next = wanted;
  wanted = null;
  next();
}

async function start() {
  const epoch = run.epoch;
  run.starting = true;
  run.busy = performance.now();
  const answer = await ask("start", { values: given() });
  run.busy = 0;
  run.starting = false;
  if (epoch === run.epoch) {
    shape();
    anew(answer);
  }
  release();
}

// What the worker began with is the run from here on.
function anew({ rows, failed, warnings = [], broken }) {
  run.rows = rows;
  run.now = 0;
  run.marks = [];
  picture.forget();
  if (rows.length) picture.remember(rows[0].row);
  take({ failed, warnings, broken });
}

function take({ failed, warnings = [], broken }) {
  if (warnings.length) run.warned = warnings[warnings.length - 1];
  run.failed = failed || "";
  if (broken) run.ready = false;
  say(run.failed || run.warned, Boolean(run.failed));
  if (run.failed && run.rows.length) play(false); // what cannot begin may begin with the next value of a slider
  update();
}

async function advance(until) {
  const epoch = run.epoch;
  run.busy = performance.now();
  run.asking = true;
  const answer = await ask("advance", { until, budget: BUDGET, inputs: inputs() });
  run.busy = 0;
  if (epoch !== run.epoch) return;
  run.asking = false;
  for (const row of answer.rows) {
    run.rows.push(row);
    picture.remember(row.row);
  }
  const most = Math.max(2, Math.floor(KEPT / about.shown.length));
  if (run.rows.length > 1.2 * most) run.rows.splice(0, run.rows.length - most);
  if (answer.failed || answer.warnings.length) take(answer);
  pursue();
}

// Ask for rows until they are ahead of the clock.
function pursue() {
  if (!run.playing || run.asking || run.starting || run.failed || !run.rows.length) return;
  const until = run.now + AHEAD * run.speed;
  if (latest() < until) advance(Math.max(until, latest() + interval));
}

const latest = () => (run.rows.length ? run.rows[run.rows.length - 1].time : 0);

function play(on) {
  run.playing = on && !run.failed;
  run.marks = [];
  find("play").classList.toggle("playing", run.playing);
  find("play").querySelector("span").textContent = run.playing ? "Pause" : "Run";
  update();
}

async function step() {
  play(false);
  if (run.failed || run.asking || !run.rows.length) return;
  await advance(latest() + interval);
  run.now = latest();
  update();
}

let before = 0;

function tick(stamp) {
  const passed = Math.min(stamp - before, 100) / 1000;
  before = stamp;
  if (run.playing && run.rows.length && !run.starting && !hidden()) {
    run.now = Math.min(run.now + passed * run.speed, latest());
    pursue();
    run.marks.push([stamp, run.now]);
    while (run.marks.length > 2 && stamp - run.marks[0][0] > 1000) run.marks.shift();
    update();
  }
  if (!run.slow && run.busy && performance.now() - run.busy > SLOW && !run.failed) {
    say("This communication step takes long. Wait, or reset to stop it.");
    run.slow = true;
  } else if (run.slow && !run.busy) {
    run.slow = false;
    say(run.failed || run.warned, Boolean(run.failed));
  }
  if (run.changed) show(stamp);
  requestAnimationFrame(tick);
}

// In a frame that is not shown, nothing moves.
const hidden = () => EMBEDDED && !find("picture").clientWidth;

const update = () => { run.changed = true; };

// The row of the clock, between two that were computed.
function present() {
  const { rows, now } = run;
  let low = 0, high = rows.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (rows[middle].time <= now) low = middle; else high = middle - 1;
  }
  const a = rows[low], b = rows[Math.min(low + 1, rows.length - 1)];
  if (!a) return null;
  const share = b.time > a.time ? Math.min(1, (now - a.time) / (b.time - a.time)) : 0;
  return { index: low, row: share ? a.row.map((x, i) => x + share * (b.row[i] - x)) : a.row, exact: a };
}

// What is shown -----------------------------------------------------------------------------------------------------------

let picture = { forget() {}, remember() {}, shape() {}, draw() {}, refit() {}, hit: () => null };
if (!about.picture) find("picture").hidden = true;

// The picture, in space once the library is there.
async function see() {
  if (!about.picture) return;
  if (about.picture.kind === "space") {
    const script = document.createElement("script");
    script.src = URL.createObjectURL(new Blob([await bytes("space")], { type: "text/javascript" }));
    await new Promise((go) => { script.onload = go; document.head.append(script); });
  }
  picture = about.picture.kind === "space" ? new Space(find("picture"), about.picture) : new Plane(find("picture"), about.picture);
  shape();
}

const seen = see();

// Shapes for the parameters as the controls say.
function shape() {
  if (picture.about) picture.shape(geometry(about.picture.parameters.map((p) => ("ref" in p ? values.get(p.ref) : p.value))));
}

function show(stamp) {
  run.changed = false;
  if (hidden()) return;
  const at = present();
  if (at || run.drawn) picture.draw((at || run.drawn).row);
  if (!at) return;
  run.drawn = at;
  find("time").textContent = `${run.now.toFixed(2)} s`;
  const marks = run.marks || [], first = marks[0], last = marks[marks.length - 1];
  const factor = marks.length > 5 ? 1000 * (last[1] - first[1]) / (last[0] - first[0]) : NaN;
  find("factor").textContent = !run.playing ? "paused" : Number.isNaN(factor) ? "…" : `${factor.toFixed(2)} ×`;
  const read = (name) => (place.has(name) ? at.exact.row[place.get(name)] : NaN);
  const write = (id, value, unit) => { find(id).textContent = Number.isFinite(value) ? `${brief(value)} ${unit}`.trim() : "not computed"; };
  write("position_error", read("monitor.position_error"), "");
  write("velocity_error", read("monitor.velocity_error"), "1/s");
  write("energy", read("monitor.energy"), "J");
  const begun = run.rows[0].row, work = place.has("monitor.work") ? read("monitor.work") : 0;
  const zero = place.has("monitor.energy") && run.rows[0].time === 0 ? begun[place.get("monitor.energy")] : NaN;
  write("balance", read("monitor.energy") - work - zero, "J");
  if (!run.playing || stamp - (run.plotted || 0) > 60) {
    run.plotted = stamp;
    panels.forEach((panel) => panel.show(at.index));
  }
  if (run.playing || picture.settling) update();
}

function brief(value) {
  const size = Math.abs(value);
  if (value === 0) return "0";
  return size >= 1e-2 && size < 1e4 ? value.toPrecision(4) : value.toExponential(1).replace("e+", "e");
}

function say(text, bad = true) {
  const box = find("said");
  box.hidden = !text;
  box.querySelector("p").textContent = text;
  box.classList.toggle("failed", bad);
}

// Plots -------------------------------------------------------------------------------------------------------------------

const panels = [];

const LEAST = -18; // power of ten that errors below it are shown at

const DASHES = [undefined, [9, 5], [2, 4], [12, 4, 2, 4]]; // of curves that follow each other, which may coincide

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
      // In the legend, values at the cursor, or else the last ones.
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

  // The rows up to the one with this index.
  show(index) {
    const from = run.rows[index].time - WINDOW;
    let first = index;
    while (first > 0 && run.rows[first].time > from) first -= 1;
    const count = index - first + 1, every = Math.max(1, Math.ceil(count / 2000)), some = [];
    // Every so many rows, always the same ones, so that curves do not flicker.
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

// Controls ----------------------------------------------------------------------------------------------------------------

const POSITIONS = 200; // of a slider, at most

function change(reference, value, from) {
  values.set(reference, value);
  (controls.get(reference) || []).forEach((control) => { if (control !== from) control.tell(value); });
  tellCommand();
}

function number(text) {
  const value = Number(text);
  return text.trim() !== "" && Number.isFinite(value) ? value : null;
}

function control(reference, act) {
  const v = variables[reference], box = document.createElement("div"), label = document.createElement("label");
  const own = [], id = `v${reference}`, unit = v.unit && v.unit !== "1" ? v.unit : "";
  box.className = "control";
  label.htmlFor = id;
  label.append(v.label || v.name);
  if (unit) {
    const small = document.createElement("small");
    small.textContent = ` [${unit}]`;
    label.append(small);
  }
  box.append(label);
  const say = (value, from) => { change(reference, value, from); act(); };
  if (v.type === "Boolean") {
    const check = Object.assign(document.createElement("input"), { type: "checkbox", id });
    check.addEventListener("change", () => say(Number(check.checked)));
    own.push({ tell: (value) => { check.checked = Boolean(value); } });
    box.append(check);
  } else {
    const field = Object.assign(document.createElement("input"), { type: "number", step: "any", id: v.range ? `${id}n` : id });
    if (v.range) field.setAttribute("aria-label", `${v.name} as a number, ${unit}`);
    if (v.minimum !== null) field.min = v.minimum;
    if (v.maximum !== null) field.max = v.maximum;
    const numeric = { tell: (value) => { field.value = Number(Number(value).toPrecision(7)); } };
    field.addEventListener("change", () => {
      const value = number(field.value);
      const low = v.minimum ?? -Infinity, high = v.maximum ?? Infinity;
      if (value === null || value < low || value > high || (v.type === "Integer" && value !== Math.round(value))) {
        numeric.tell(values.get(reference));
        return;
      }
      say(value, numeric);
    });
    own.push(numeric);
    box.append(field);
    if (v.range) {
      const [low, high] = v.range, apart = nice((high - low) / POSITIONS), last = Math.ceil((high - low) / apart - 1e-9);
      const slider = Object.assign(document.createElement("input"), { type: "range", id, min: 0, max: last, step: 1 });
      const digits = Math.max(0, Math.min(15, -Math.floor(Math.log10(apart) + 1e-9)));
      const sliding = { tell: (value) => {
        slider.value = Math.round(last * (value - low) / (high - low));
        slider.setAttribute("aria-valuetext", `${Number(Number(value).toPrecision(4))} ${unit}`.trim());
      } };
      slider.addEventListener("input", () => {
        const raw = low + (high - low) * Number(slider.value) / last;
        const value = Math.min(v.maximum ?? Infinity, Math.max(v.minimum ?? -Infinity, Number(raw.toFixed(digits))));
        say(value, sliding);
        slider.setAttribute("aria-valuetext", `${value} ${unit}`.trim());
      });
      own.push(sliding);
      box.append(slider);
    }
  }
  if (v.description) {
    const text = Object.assign(document.createElement("p"), { className: "about", textContent: v.description, id: `${id}d` });
    box.append(text);
    box.querySelectorAll("input").forEach((input) => input.setAttribute("aria-describedby", text.id));
  }
  controls.set(reference, own);
  own.forEach((each) => each.tell(values.get(reference)));
  return box;
}

function makeControls() {
  const form = find("controls");
  const sections = [["Inputs", ["input", "switch"], () => {}, true], ["Start", ["start", "rate"], begin, true],
    ["Parameters", ["parameter"], begin, true], ["Compliances", ["compliance"], begin, false], ["Solver", ["solver"], begin, false]];
  const narrow = matchMedia("(max-width: 860px)").matches;
  for (const [title, kinds, act, open] of sections) {
    const own = variables.flatMap((v, reference) => (kinds.includes(v.kind) ? [reference] : []));
    if (!own.length) continue;
    const details = document.createElement("details"), summary = document.createElement("summary");
    details.open = open && !(narrow && title !== "Inputs");
    summary.textContent = title;
    details.append(summary, ...own.map((reference) => control(reference, act)));
    form.append(details);
  }
  const button = Object.assign(document.createElement("button"), { type: "button", id: "defaults", textContent: "All defaults" });
  button.addEventListener("click", () => {
    variables.forEach((v, reference) => { if (controls.has(reference)) change(reference, v.start); });
    picture.refit();
    begin();
  });
  form.append(button);
}

// What makes this run on a command line.
function tellCommand() {
  const text = variables.flatMap((v, reference) => {
    const value = values.get(reference);
    return v.kind === "output" || value === v.start || ["input", "switch"].includes(v.kind) ? [] : [` --set ${v.name}=${value}`];
  });
  const own = variables.flatMap((v, reference) => (
    ["input", "switch"].includes(v.kind) && values.get(reference) !== v.start ? [reference] : []));
  own.forEach((reference) => driven.add(reference));
  find("inputs").hidden = !driven.size;
  find("command").textContent = about.command + text.join("") + (driven.size ? ` --input ${about.name}_inputs.csv` : "");
}

const driven = new Set(); // inputs that have been changed

// Rows so far: time, outputs, inputs, in digits that give the same numbers again. `some` chooses columns.
function csv(some = () => true) {
  const write = (x) => (Number.isNaN(x) ? "nan" : Number.isFinite(x) ? String(x) : x > 0 ? "inf" : "-inf");
  const quoted = (name) => (/[",\n]/.test(name) ? `"${name.replaceAll('"', '""')}"` : name);
  const chosen = about.shown.flatMap((reference, column) => (some(variables[reference]) ? [column] : []));
  const names = chosen.map((column) => quoted(variables[about.shown[column]].name));
  const lines = run.rows.map(({ time, row }) => [time, ...chosen.map((column) => row[column])].map(write).join(","));
  return [["time", ...names].join(","), ...lines].join("\r\n") + "\r\n";
}

function save(text, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

// Pointer and keys --------------------------------------------------------------------------------------------------------

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
  // Rates go to zero: the mechanism is held.
  const starts = ties([...run.drawn.exact.q], about.tie_parameters.map((p) => ("ref" in p ? values.get(p.ref) : p.value)));
  pulling = { point, playing, starts, to: [x, y], busy: false, moved: false };
  picture.grabbed = true;
  canvas.style.cursor = "grabbing";
}

// Assemble the mechanism anew, where the point that is held is nearest to the pointer.
async function pull() {
  if (!pulling || pulling.busy || !pulling.fresh || run.starting) return;
  const mine = pulling, { point } = mine;
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
    target: picture.metres(...mine.to),
    point: { x: point.x, y: point.y, references: point.columns.map((c) => about.shown[c]) },
  });
  mine.busy = false;
  mine.starts = answer.found || mine.starts;
  about.tied.forEach(({ value }, i) => change(value, mine.starts[i]));
  anew(answer);
  picture.pulled = pulling ? { ...point, to: mine.to } : null;
  if (mine.fresh) pull(); else if (mine.released) mine.released();
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
    pulling.fresh = true;
    pull();
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
// It moves at once, unless the reader asked for less motion.
if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);

// For the console, and whoever drives the page.
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
  // Run to a time [s] as fast as it goes, and pause there.
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
    busy: Boolean(run.busy || run.starting || wanted), rows: run.rows.length,
  }),
};
