// The page: the clock of the run, and its display. The worker has the runtime; the page requests rows ahead of the clock.

const about = JSON.parse(document.getElementById("about").textContent);
const find = (id) => document.getElementById(id);
const { variables, interval } = about;
const place = new Map(about.shown.map((reference, column) => [variables[reference].name, column]));

const EMBEDDED = location.hash === "#embedded"; // in a frame of another page
document.documentElement.toggleAttribute("data-embedded", EMBEDDED);

const AHEAD = 0.05; // time [s] by which rows are requested before they are shown
const BUDGET = 20; // work of the worker between two answers [ms]; at least one communication step
const SLOW = 2500; // time [ms] after which a step is reported as slow
const KEPT = 6e6; // largest number of values kept for plots and the table
const WINDOW = Math.min(10, about.stop_time); // time shown by plots [s]

const values = new Map(variables.map((v, reference) => [reference, v.start])); // values of the controls
const controls = new Map(); // elements that show a value, by reference
const run = { rows: [], now: 0, playing: false, speed: 1, epoch: 0, busy: 0, failed: "", warned: "", ready: false, drawn: null };

// Messages to the worker ------------------------------------------------------------------------------------------------

let worker = null, asked = 0;
const waiting = new Map();

function ask(kind, message = {}, transfer = []) {
  return new Promise((answer) => {
    waiting.set(++asked, answer);
    worker.postMessage({ id: asked, kind, ...message }, transfer);
  });
}

// Start a worker with library and scene, in place of the present one.
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

// Return the values of a start that differ from their defaults.
const given = () => variables.flatMap((v, reference) => (
  v.kind === "output" || values.get(reference) === v.start ? [] : [[reference, values.get(reference)]]));

let wanted = null; // the next start, made once the worker is free

// Begin at time 0 with the values of the controls.
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

// Use the run that the worker has begun.
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
  if (run.failed && run.rows.length) play(false); // the next value of a slider may permit a start
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

// Request rows until they are ahead of the clock.
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

// A hidden frame does not run.
const hidden = () => EMBEDDED && !find("picture").clientWidth;

const update = () => { run.changed = true; };

// Return the row at the time of the clock, interpolated between two computed ones.
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

// Display -----------------------------------------------------------------------------------------------------------

let picture = { forget() {}, remember() {}, shape() {}, draw() {}, refit() {}, hit: () => null };
if (!about.picture) find("picture").hidden = true;

// Make the picture; in space once its library is loaded.
async function see() {
  if (!about.picture) return;
  if (about.picture.kind === "space") {
    if (!document.createElement("canvas").getContext("webgl2")) {
      find("hint").textContent = "This browser has no WebGL, which pictures of space need: plots show the motion.";
      find("picture").hidden = true;
      return;
    }
    await loaded("space");
  }
  picture = about.picture.kind === "space" ? new Space(find("picture"), about.picture) : new Plane(find("picture"), about.picture);
  shape();
}

const seen = see();

// Compute the shapes for the parameters of the controls.
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
