// The runtime in a worker: it has one instance of the scene, and makes the communication steps that the page requests.
// A slow step blocks only this worker, which the page can end and start again.
"use strict";

const DONE = 0;
const WHY = 500; // largest length of a message [bytes]

class Engine {
  // `wasm` and `scene` are the contents of alfmu-wasm32.wasm and of scene.bin.
  constructor(wasm, scene) {
    const instance = new WebAssembly.Instance(new WebAssembly.Module(wasm), {});
    this.c = instance.exports;
    this.c._initialize();
    const bytes = this.room(scene.length), why = this.room(WHY);
    new Uint8Array(this.c.memory.buffer).set(scene, bytes);
    this.scene = this.c.alfmu_scene_load(bytes, scene.length, why, WHY);
    if (!this.scene) throw new Error(this.text(why));
    this.c.free(bytes);
    this.count = this.c.alfmu_variable_count(this.scene);
    this.values = this.room(8 * this.count);
    this.instance = 0;
  }

  room(size) {
    const place = this.c.malloc(size);
    if (!place) throw new Error("There is no memory left for this mechanism.");
    return place;
  }

  text(place) {
    const bytes = new Uint8Array(this.c.memory.buffer, place), end = bytes.indexOf(0);
    return new TextDecoder().decode(bytes.slice(0, end));
  }

  // Return the reason why the last call was refused or failed.
  why() { return this.text(this.c.alfmu_text(this.instance)); }

  // Return the unread warning, if there is one.
  warning() {
    const place = this.c.alfmu_warns(this.instance), flag = new Int32Array(this.c.memory.buffer, place, 1);
    if (!flag[0]) return "";
    flag[0] = 0;
    return this.text(this.c.alfmu_warning(this.instance));
  }

  // Begin at time 0 with these values, pairs [reference, value]. Return the reason if this is impossible, else "".
  start(values) {
    const c = this.c;
    if (this.instance) c.alfmu_free(this.instance);
    this.instance = c.alfmu_new(this.scene);
    if (!this.instance) throw new Error("There is no memory left for an instance.");
    for (const [reference, value] of values) if (c.alfmu_set(this.instance, reference, value) !== DONE) return this.why();
    if (c.alfmu_initialize(this.instance) !== DONE) return this.why();
    c.alfmu_run_on(this.instance, 1);
    return "";
  }

  // Make one communication step [s], then set the inputs. Return the reason if it failed, else "".
  step(time, length, inputs) {
    const c = this.c;
    if (c.alfmu_step(this.instance, time, length) !== DONE) return this.why();
    for (const [reference, value] of inputs) if (c.alfmu_set(this.instance, reference, value) !== DONE) return this.why();
    return "";
  }

  // Return the present values of these references; `failed` is the reason if some could not be computed.
  read(references) {
    const c = this.c, places = this.room(4 * references.length);
    new Int32Array(c.memory.buffer, places, references.length).set(references);
    const outcome = c.alfmu_get_many(this.instance, places, references.length, this.values);
    const row = new Float64Array(c.memory.buffer, this.values, references.length).slice();
    c.free(places);
    return { row, failed: outcome === DONE ? "" : this.why() };
  }

  // Return the first `count` numbers of the state: the coordinates q.
  coordinates(count) {
    return new Float64Array(this.c.memory.buffer, this.c.alfmu_state(this.instance), count).slice();
  }
}

// Return start values that minimise the sum of squares of the distances, by damped Gauss-Newton steps
// from `starts`. `assembled(starts)` returns the distances, or null if the loops cannot be closed.
function nearest(starts, assembled) {
  const MOST = 12, TURN = 0.25, NUDGE = 1e-6, ENOUGH = 1e-7;
  let now = assembled(starts), damping = 1e-6;
  for (let k = 0; now && k < MOST; k++) {
    const n = starts.length, slopes = [];
    for (let i = 0; i < n; i++) {
      const beside = assembled(starts.map((s, j) => s + (i === j ? NUDGE : 0)));
      slopes.push(beside ? beside.map((d, r) => (d - now[r]) / NUDGE) : now.map(() => 0));
    }
    const A = slopes.map((a, i) => slopes.map((b, j) => dot(a, b) * (i === j ? 1 + damping : 1) + (i === j ? 1e-12 : 0)));
    const change = solved(A, slopes.map((a) => -dot(a, now)));
    const longest = Math.max(...change.map(Math.abs));
    const tried = starts.map((s, i) => s + change[i] * Math.min(1, TURN / (longest || 1)));
    const there = assembled(tried);
    if (there && dot(there, there) < dot(now, now)) {
      [starts, now, damping] = [tried, there, damping / 10];
      if (longest < ENOUGH) break;
    } else if ((damping = Math.max(damping, 1e-3) * 10) > 1e3) break;
  }
  return starts;
}

function dot(a, b) { return a.reduce((sum, x, i) => sum + x * b[i], 0); }

// Solve a small system A x = b by elimination with pivoting.
function solved(A, b) {
  const n = b.length, rows = A.map((row, i) => [...row, b[i]]);
  for (let k = 0; k < n; k++) {
    let p = k;
    for (let i = k + 1; i < n; i++) if (Math.abs(rows[i][k]) > Math.abs(rows[p][k])) p = i;
    [rows[k], rows[p]] = [rows[p], rows[k]];
    for (let i = k + 1; i < n; i++) {
      const share = rows[i][k] / rows[k][k];
      for (let j = k; j <= n; j++) rows[i][j] -= share * rows[k][j];
    }
  }
  const x = new Array(n).fill(0);
  for (let k = n - 1; k >= 0; k--) {
    x[k] = (rows[k][n] - x.reduce((sum, xi, i) => sum + (i > k ? rows[k][i] * xi : 0), 0)) / rows[k][k];
  }
  return x;
}
