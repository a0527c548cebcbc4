// Answers of the worker: each message has a `kind` and an `id`, which its answer repeats.
"use strict";

let engine = null, about = null, failed = "", made = 0;

const answers = {
  // Load library and scene; `about` describes the scene.
  load(message) {
    about = message.about;
    engine = new Engine(message.wasm, message.scene);
    if (engine.count !== about.count) throw new Error("The scene in this page is damaged: save the page again.");
    return {};
  },

  // Begin a run at time 0.
  start({ values }) {
    made = 0;
    failed = engine.start(values);
    return failed ? { failed, rows: [] } : read([], []);
  },

  // Make communication steps up to `until` [s], at least one, for at most `budget` [ms], with inputs from the first
  // communication point on.
  advance({ until, budget, inputs }) {
    const begun = performance.now(), rows = [], warnings = [];
    while (!failed && (made + 1) * about.interval <= until * (1 + 1e-12)) {
      // The points are 0, h, 2 h, ..., as in every host of alfmu.
      const time = made * about.interval, next = (made + 1) * about.interval;
      failed = engine.step(time, next - time, inputs);
      if (!failed) {
        made += 1;
        read(rows, warnings);
      }
      if (performance.now() - begun > budget) break;
    }
    return { rows, warnings, failed, took: performance.now() - begun };
  },

  // Find start values at rest that bring a point nearest to `target`; `values` are all others.
  pull({ values, starts, target, point }) {
    made = 0;
    const at = (s) => {
      const rates = about.tied.map(({ rate }) => [rate, 0]);
      const given = about.tied.map(({ value }, i) => [value, s[i]]);
      if (engine.start([...values, ...rates, ...given])) return null;
      const [x, y, angle] = engine.read(point.references).row;
      const c = Math.cos(angle), d = Math.sin(angle);
      return [x + c * point.x - d * point.y - target[0], y + d * point.x + c * point.y - target[1]];
    };
    const found = nearest(starts, at);
    const rows = at(found) ? read([], []).rows : [];
    return { rows, found, failed: rows.length ? "" : engine.why() };
  },
};

function read(rows, warnings) {
  const { row, failed: why } = engine.read(about.shown);
  rows.push({ time: made * about.interval, row, q: engine.coordinates(about.n) });
  const warning = engine.warning();
  if (warning) warnings.push(warning);
  failed = why;
  return { rows, warnings, failed };
}

onmessage = ({ data }) => {
  try {
    postMessage({ id: data.id, ...answers[data.kind](data) });
  } catch (error) {
    postMessage({ id: data.id, rows: [], failed: String(error.message || error), broken: true });
  }
};
