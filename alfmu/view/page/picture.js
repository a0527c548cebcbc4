// Pictures of a mechanism on a canvas: one of the plane, one of space. Both take the numbers of its shapes (`numbers`, what
// the page's function `geometry` gives for the parameters as they are) and a row of outputs.

const COLORS = ["#6b9bc7", "#e3b05f", "#76b18f", "#d0826f", "#9d8fc6", "#58a9ae", "#c98ca9", "#9aa4ae"];

const TRAIL = 600; // places that a trail keeps

class Canvas {
  constructor(canvas, about) {
    this.canvas = canvas;
    this.about = about;
    this.pen = canvas.getContext("2d");
    this.names = false;
    this.trails = about.dots.map(() => []);
    const named = [...about.links, ...about.bodies, ...about.bars, ...about.dots];
    this.colors = Object.fromEntries(named.map(({ name }, i) => [name, COLORS[i % COLORS.length]]));
  }

  // Sizes and colours as the page has them now.
  begin() {
    const ratio = devicePixelRatio, width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    Object.assign(this, { width, height });
    const style = getComputedStyle(this.canvas);
    this.color = (name) => style.getPropertyValue("--" + name).trim();
    this.ink = this.color("ink");
    this.rim = Number(this.color("rim"));
    const pen = this.pen;
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = this.color("paper");
    pen.fillRect(0, 0, width, height);
    pen.lineCap = pen.lineJoin = "round";
  }

  // A line with round ends; a disc where it has one point, an area where it is filled.
  line(points, width, color, filled = false) {
    const pen = this.pen;
    pen.lineWidth = width;
    pen.strokeStyle = pen.fillStyle = color;
    pen.beginPath();
    if (points.length === 1) {
      pen.arc(...points[0], width / 2, 0, 2 * Math.PI);
      pen.fill();
      return;
    }
    for (const [x, y] of points) pen.lineTo(x, y);
    if (filled) { pen.closePath(); pen.fill(); }
    pen.stroke();
  }

  outlined(points, width, color, filled = false) {
    this.line(points, width + 2.6 * this.unit, this.shade(color), filled);
    this.line(points, width, color, filled);
  }

  // The rim of a colour: darker on a light page, lighter on a dark one.
  shade(color) {
    const whole = (i) => Math.min(255, Math.round(parseInt(color.slice(i, i + 2), 16) * this.rim));
    return `rgb(${whole(1)}, ${whole(3)}, ${whole(5)})`;
  }

  text(text, x, y, color = this.ink, align = "center", size = 12) {
    const pen = this.pen;
    pen.font = `${size}px system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif`;
    pen.textAlign = align;
    pen.textBaseline = "middle";
    pen.lineWidth = 3.5;
    pen.strokeStyle = this.color("paper");
    pen.strokeText(text, x, y);
    pen.fillStyle = color;
    pen.fillText(text, x, y);
  }

  // A spring, a damper or both from one point to another in pixels.
  tie(kind, [ax, ay], [bx, by]) {
    const u = this.unit, length = Math.hypot(bx - ax, by - ay) || 1;
    const at = (along, across) => [
      ax + (bx - ax) * along - (by - ay) / length * across * u, ay + (by - ay) * along + (bx - ax) / length * across * u,
    ];
    const line = (points, width = 2) => this.line(points.map((p) => at(...p)), width * u, this.ink);
    if (kind === "rod") line([[0, 0], [1, 0]], 4);
    const apart = kind === "spring-damper" ? 9 : 0;
    if (kind.includes("spring")) {
      const teeth = Array.from({ length: 13 }, (_, i) => [0.26 + 0.04 * i, apart + (i % 2 ? 7 : -7)]);
      line([[0, 0], [0.15, 0], [0.15, apart], [0.23, apart], ...teeth, [0.77, apart], [0.85, apart], [0.85, 0], [1, 0]], 1.8);
    }
    if (kind.includes("damper")) {
      const y = -apart;
      line([[0, 0], [0.15, 0], [0.15, y], [0.38, y]]);
      line([[0.62, y + 6], [0.38, y + 6], [0.38, y - 6], [0.62, y - 6]]);
      line([[0.52, y + 3], [0.52, y - 3]], 3);
      line([[0.52, y], [0.85, y], [0.85, 0], [1, 0]]);
    }
    for (const end of [[0, 0], [1, 0]]) line([end], kind === "rod" ? 9 : 6);
  }

  // The mechanism begins anew.
  forget() { this.trails.forEach((trail) => { trail.length = 0; }); }

  remember(row) {
    this.about.dots.forEach(({ columns }, i) => {
      const trail = this.trails[i];
      trail.push(columns.map((c) => row[c]));
      if (trail.length > TRAIL) trail.shift();
    });
  }

  faded(trail, color, width) {
    const pieces = 12, length = Math.ceil(trail.length / pieces);
    for (let k = 0; k < pieces; k++) {
      const piece = trail.slice(k * length, (k + 1) * length + 1);
      if (piece.length < 2) continue;
      this.pen.globalAlpha = 0.15 + 0.65 * (k + 1) / pieces;
      this.line(piece, width, color);
    }
    this.pen.globalAlpha = 1;
  }
}

class Plane extends Canvas {
  constructor(canvas, about) {
    super(canvas, about);
    this.columns = Object.fromEntries([...about.links, ...about.dots].map(({ name, columns }) => [name, columns]));
    this.low = [...about.low];
    this.high = [...about.high];
    this.travel = about.travel.map((range) => [...range]);
    const key = (a) => `${a.body} ${a.x} ${a.y}`;
    // Hinges, welds and pins; those that share a point are one.
    this.knots = [];
    for (const joint of about.joints) {
      if (joint.kind === "prismatic" || joint.kind === "distance") continue;
      const pin = joint.kind === "point_on_line", anchors = pin ? [joint.second] : [joint.first, joint.second];
      const knot = { names: pin ? [] : [joint.name], kind: joint.kind, anchors };
      const shared = this.knots.filter((k) => k.anchors.some((a) => anchors.some((b) => key(a) === key(b))));
      for (const other of shared) {
        knot.names.unshift(...other.names);
        knot.anchors = [...other.anchors, ...knot.anchors];
        knot.kind = other.kind;
        this.knots.splice(this.knots.indexOf(other), 1);
      }
      this.knots.push(knot);
    }
    const held = about.joints.filter((j) => ["revolute", "weld", "distance"].includes(j.kind))
      .map((j) => [j.first, j.second, j.kind !== "weld"]);
    held.push(...about.ties.filter((t) => t.kind !== "spiral").map((t) => [t.first, t.second, true]));
    this.supports = held.flatMap(([a, b, legs]) => [a, b].map((at) => [at, legs])).filter(([at]) => at.body === "ground");
    this.supports = [...new Map(this.supports.map((s) => [key(s[0]), s])).values()];
  }

  shape(numbers) {
    this.numbers = numbers;
    const point = ([x, y]) => [numbers[x], numbers[y]];
    this.links = this.about.links.map((link) => ({ ...link, points: link.points.map(point) }));
    for (const link of this.links) link.hull = hull(link.points);
  }

  // Pose of a body in this row: x [m], y [m], angle [rad].
  pose(row, body) {
    const columns = this.columns[body];
    if (!columns) return [0, 0, 0];
    const [x, y, angle] = columns.map((c) => row[c]);
    return [x, y, angle || 0];
  }

  // A point of a body in ground axes [m].
  place(row, body, x, y) {
    const [px, py, angle] = this.pose(row, body), c = Math.cos(angle), s = Math.sin(angle);
    return [px + c * x - s * y, py + s * x + c * y];
  }

  anchor(row, at) { return this.place(row, at.body, this.numbers[at.x], this.numbers[at.y]); }

  pixels([x, y]) { return [this.middle[0] + this.scale * x, this.middle[1] - this.scale * y]; }

  metres(x, y) { return [(x - this.middle[0]) / this.scale, (this.middle[1] - y) / this.scale]; }

  // Keep all that moves in the picture.
  fit(row) {
    const points = this.links.flatMap((link) => link.points.map((p) => this.place(row, link.name, ...p)));
    points.push(...this.supports.map(([at]) => this.anchor(row, at)));
    points.push(...this.about.dots.map(({ name }) => this.place(row, name, 0, 0)));
    for (const p of points) {
      for (const k of [0, 1]) {
        if (!Number.isFinite(p[k])) continue;
        this.low[k] = Math.min(this.low[k], p[k]);
        this.high[k] = Math.max(this.high[k], p[k]);
      }
    }
    const base = Math.max(0.62, Math.min(this.width / 640, this.height / 480, 1.25));
    const margin = 104 * base;
    let spans = [0, 1].map((k) => this.high[k] - this.low[k]);
    if (Math.max(...spans) < 1e-9) spans = [1, 1];
    const room = [this.width - margin, this.height - margin];
    const scale = Math.min(...[0, 1].filter((k) => spans[k] > 1e-12).map((k) => room[k] / spans[k]));
    const center = [0, 1].map((k) => (this.low[k] + this.high[k]) / 2);
    if (this.held && this.scale) return; // what is dragged stays under the pointer
    // Ease towards what fits, at once where it would be cut off by much.
    const ease = this.scale && Math.abs(Math.log(scale / this.scale)) < 0.7 && this.sized === this.width ? 0.2 : 1;
    this.sized = this.width;
    this.settling = ease < 1 && Math.abs(Math.log(scale / this.scale)) > 1e-3; // another picture shows more of it
    this.scale = this.scale ? this.scale * (scale / this.scale) ** ease : scale;
    const middle = [this.width / 2 - this.scale * center[0], this.height / 2 + 6 * base + this.scale * center[1]];
    this.middle = this.middle && ease < 1 ? this.middle.map((m, k) => m + ease * (middle[k] - m)) : middle;
    const lengths = this.links.filter((l) => l.points.length > 1).map((l) => this.scale * extent(l.points)).sort((a, b) => a - b);
    const usual = lengths.length ? lengths[lengths.length >> 1] : 80 * base;
    this.unit = base * Math.min(1, Math.max(0.3, usual / (80 * base)));
  }

  // The whole room again, as when the page was opened.
  refit() {
    this.low = [...this.about.low];
    this.high = [...this.about.high];
    this.travel = this.about.travel.map((range) => [...range]);
    this.scale = 0;
  }

  draw(row) {
    this.begin();
    this.fit(row);
    this.grid();
    for (const [at, legs] of this.supports) this.support(this.pixels(this.anchor(row, at)), legs);
    const guides = this.about.guides.map((guide, i) => ({ ...guide, ...this.rails(row, guide, i) }));
    for (const guide of guides) if (guide.base.body === "ground") this.guide(guide);
    this.about.dots.forEach(({ name }, i) => {
      const trail = [...this.trails[i].map((p) => this.pixels(p)), this.pixels(this.place(row, name, 0, 0))];
      this.faded(trail, this.colors[name], 2.5 * this.unit);
    });
    for (const link of this.links) this.link(row, link);
    for (const guide of guides) {
      if (guide.base.body !== "ground") this.guide(guide);
      if (guide.block !== null) this.block(row, guide);
    }
    for (const tie of this.about.ties) {
      const [a, b] = [tie.first, tie.second].map((at) => this.pixels(this.anchor(row, at)));
      if (tie.kind === "spiral") this.spiral(a); else this.tie(tie.kind, a, b);
    }
    for (const knot of this.knots) this.knot(this.pixels(this.anchor(row, knot.anchors[0])), knot.kind);
    for (const { name } of this.about.dots) {
      this.outlined([this.pixels(this.place(row, name, 0, 0))], 14 * this.unit, this.colors[name]);
    }
    if (this.names) this.labels(row);
    if (this.pulled) {
      const from = this.pixels(this.place(row, this.pulled.name, this.pulled.x, this.pulled.y));
      this.pen.setLineDash([4, 4]);
      this.line([from, this.pulled.to], 1.5, this.color("accent"));
      this.pen.setLineDash([]);
      this.line([from], 9, this.color("accent"));
    }
  }

  grid() {
    const cell = nice(70 / this.scale), [left, top] = this.metres(0, 0), [right, bottom] = this.metres(this.width, this.height);
    const lines = [[0, left, right], [1, bottom, top]].flatMap(([k, low, high]) => {
      const some = [];
      for (let i = Math.ceil(low / cell); i <= high / cell; i++) some.push([k, i]);
      return some;
    });
    for (const [k, i] of lines.sort((a, b) => (a[1] === 0) - (b[1] === 0))) {
      const ends = k === 0 ? [[i * cell, bottom], [i * cell, top]] : [[left, i * cell], [right, i * cell]];
      this.line(ends.map((p) => this.pixels(p)), 1, this.color(i ? "grid" : "zero"));
    }
    const x = this.width - 14, y = this.height - 16, faint = this.color("faint");
    this.line([[x - cell * this.scale, y], [x, y]], 1.5, faint);
    for (const end of [x - cell * this.scale, x]) this.line([[end, y - 4], [end, y + 4]], 1.5, faint);
    this.text(`${Number(cell.toPrecision(3))} m`, x - cell * this.scale / 2, y - 11, faint);
  }

  hatch([x, y], along, low, high, drop) {
    const u = this.unit, c = Math.cos(along), s = Math.sin(along);
    const at = (a, b) => [x + c * a + s * b, y - s * a + c * b];
    for (let a = low + 7 * u; a < high; a += 7 * u) this.line([at(a, drop), at(a - 7 * u, drop + 8 * u)], 1.2 * u, this.color("faint"));
    this.line([at(low, drop), at(high, drop)], 2 * u, this.ink);
  }

  support([x, y], legs) {
    const u = this.unit, foot = (legs ? 24 : 9) * u;
    this.hatch([x, y], 0, -24 * u, 24 * u, foot);
    if (legs) this.outlinedIn([[x, y], [x - 13 * u, y + foot], [x + 13 * u, y + foot]], 2 * u, this.color("steel"));
  }

  outlinedIn(points, width, color) {
    this.line(points, width + 2.6 * this.unit, this.ink, true);
    this.line(points, width, color, true);
  }

  // Where a guide is, and how far it is used.
  rails(row, guide, i) {
    const base = this.anchor(row, guide.base), rider = this.anchor(row, guide.rider);
    const turn = this.pose(row, guide.base.body)[2] + this.numbers[guide.axis];
    const along = (rider[0] - base[0]) * Math.cos(turn) + (rider[1] - base[1]) * Math.sin(turn);
    const range = this.travel[i];
    if (Number.isFinite(along)) this.travel[i] = [Math.min(range[0], along), Math.max(range[1], along)];
    return { at: this.pixels(base), turn };
  }

  half(guide) { return (guide.block === null ? 9 : 15) * this.unit; }

  guide(guide) {
    const u = this.unit, i = this.about.guides.findIndex((g) => g.name === guide.name), half = this.half(guide);
    const [low, high] = this.travel[i].map((end, k) => end * this.scale + (k ? 50 : -50) * u);
    const c = Math.cos(guide.turn), s = Math.sin(guide.turn), [x, y] = guide.at;
    const at = (a, b) => [x + c * a + s * b, y - s * a + c * b];
    if (guide.base.body === "ground") this.hatch(guide.at, guide.turn, low, high, half);
    else this.line([at(low, half), at(high, half)], 2 * u, this.ink);
    if (guide.base.body !== "ground" || guide.block === null) this.line([at(low, -half), at(high, -half)], 2 * u, this.ink);
    this.pen.setLineDash([10 * u, 5 * u, 1, 5 * u]);
    this.line([at(low, 0), at(high, 0)], u, this.color("faint"));
    this.pen.setLineDash([]);
  }

  block(row, guide) {
    const u = this.unit, [x, y] = this.pixels(this.anchor(row, guide.rider)), h = this.half(guide) - 2 * u, w = 24 * u;
    const turn = this.pose(row, guide.rider.body)[2] + this.numbers[guide.block], c = Math.cos(turn), s = Math.sin(turn);
    const corners = [[-w, -h], [w, -h], [w, h], [-w, h]].map(([a, b]) => [x + c * a + s * b, y - s * a + c * b]);
    this.outlined(corners, 4 * u, this.colors[guide.rider.body], true);
  }

  link(row, link) {
    const u = this.unit, points = link.hull.map((p) => this.pixels(this.place(row, link.name, ...p)));
    if (points.length > 1) this.outlined(points, (link.kind === "mass" ? 8 : 14) * u, this.colors[link.name], points.length > 2);
    if (link.kind === "mass") this.outlined([this.pixels(this.place(row, link.name, 0, 0))], 28 * u, this.colors[link.name]);
  }

  knot([x, y], kind) {
    const u = this.unit;
    if (kind === "weld") {
      this.line([[-3, -3], [3, -3], [3, 3], [-3, 3]].map(([a, b]) => [x + a * u, y + b * u]), 2 * u, this.ink, true);
      return;
    }
    this.line([[x, y]], 16.2 * u, "#2b3440");
    this.line([[x, y]], 13 * u, this.color("white"));
  }

  spiral([x, y]) {
    const points = Array.from({ length: 61 }, (_, i) => {
      const t = 5 * Math.PI * i / 60, r = (10 + 0.7 * t) * this.unit;
      return [x + r * Math.cos(t), y - r * Math.sin(t)];
    });
    this.line(points, 1.5 * this.unit, this.ink);
  }

  labels(row) {
    const size = Math.max(11, 13 * this.unit), taken = [];
    // At the first of some places where it covers no other name.
    const write = (text, places, color) => {
      const half = 0.29 * size * text.length + 2;
      const free = places.find(([x, y]) => taken.every(([a, b, c]) => Math.abs(x - a) > half + c || Math.abs(y - b) > size));
      const [x, y] = free || places[0];
      taken.push([x, y, half]);
      this.text(text, x, y, color, "center", size);
    };
    const around = ([x, y], gap) => [[0, -1], [0.75, -0.75], [-0.75, -0.75], [1.2, 0], [-1.2, 0], [0, 1]]
      .map(([a, b]) => [x + a * gap * 1.2, y + b * gap]);
    for (const knot of this.knots) {
      const text = [...new Set(knot.names)].join(", ");
      if (text) write(text, around(this.pixels(this.anchor(row, knot.anchors[0])), 20 * this.unit + 4));
    }
    for (const link of this.links) {
      const points = link.hull.map((p) => this.pixels(this.place(row, link.name, ...p)));
      const middle = [0, 1].map((k) => points.reduce((sum, p) => sum + p[k], 0) / points.length);
      write(link.name, around(middle, 16 * this.unit + 6), this.color("soft"));
    }
    for (const { name } of this.about.dots) write(name, around(this.pixels(this.place(row, name, 0, 0)), 20 * this.unit));
  }

  // The body under the pointer, and its point there; null where there is none.
  hit(row, x, y) {
    const near = [];
    for (const link of this.links) {
      const points = link.hull.map((p) => this.pixels(this.place(row, link.name, ...p)));
      const ends = points.length > 1 ? points.map((p, i) => [p, points[(i + 1) % points.length]]) : [[points[0], points[0]]];
      if (link.kind === "mass") ends.push([1, 1].map(() => this.pixels(this.place(row, link.name, 0, 0))));
      near.push([Math.min(...ends.map(([a, b]) => away([x, y], a, b))) / (points.length > 2 ? 2 : 1), link]);
    }
    for (const dot of this.about.dots) near.push([away([x, y], ...[1, 1].map(() => this.pixels(this.place(row, dot.name, 0, 0)))), dot]);
    near.sort((a, b) => a[0] - b[0]);
    if (!near.length || near[0][0] > 22) return null;
    const { name, columns } = near[0][1], [px, py, angle] = this.pose(row, name), [mx, my] = this.metres(x, y);
    const c = Math.cos(angle), s = Math.sin(angle);
    if (columns.length < 3) return { name, columns, x: 0, y: 0 };
    return { name, columns, x: c * (mx - px) + s * (my - py), y: -s * (mx - px) + c * (my - py) };
  }
}

class Space extends Canvas {
  constructor(canvas, about) {
    super(canvas, about);
    this.home();
    this.frames = Object.fromEntries([...about.bodies, ...about.dots].map((b) => [b.name, b]));
  }

  home() {
    Object.assign(this, { yaw: -0.95, pitch: 0.38, zoom: 1 });
    this.low = [...this.about.low];
    this.high = [...this.about.high];
  }

  refit() { this.home(); }

  shape(numbers) { this.numbers = numbers; }

  turn(dx, dy) {
    this.yaw -= dx;
    this.pitch = Math.max(-1.5, Math.min(1.5, this.pitch + dy));
  }

  // A point of a body, by the places of its coordinates among the numbers, in ground axes [m].
  place(row, name, point) {
    const local = point.map((i) => this.numbers[i]), frame = this.frames[name];
    if (!frame) return local;
    return this.moved(row, frame, local);
  }

  moved(row, { columns }, [a, b, c]) {
    const [x, y, z, e0, e1, e2, e3] = columns.map((i) => row[i]);
    if (columns.length === 3) return [x + a, y + b, z + c];
    return [
      x + (e0 * e0 + e1 * e1 - e2 * e2 - e3 * e3) * a + 2 * (e1 * e2 - e0 * e3) * b + 2 * (e1 * e3 + e0 * e2) * c,
      y + 2 * (e1 * e2 + e0 * e3) * a + (e0 * e0 - e1 * e1 + e2 * e2 - e3 * e3) * b + 2 * (e2 * e3 - e0 * e1) * c,
      z + 2 * (e1 * e3 - e0 * e2) * a + 2 * (e2 * e3 + e0 * e1) * b + (e0 * e0 - e1 * e1 - e2 * e2 + e3 * e3) * c,
    ];
  }

  widen(point) {
    point.forEach((p, k) => {
      if (!Number.isFinite(p)) return;
      this.low[k] = Math.min(this.low[k], p);
      this.high[k] = Math.max(this.high[k], p);
    });
  }

  // Place [m] and axis of a joint that is drawn by itself.
  pin(row, { columns, numbers }) {
    const all = columns.length ? columns.map((i) => row[i]) : numbers.map((i) => this.numbers[i]);
    return [all.slice(0, 3), all.length > 3 ? all.slice(3) : null];
  }

  fit(row) {
    for (const pin of this.about.pins) this.widen(this.pin(row, pin)[0]);
    for (const frame of [...this.about.bodies, ...this.about.dots]) {
      for (const point of [[0, 0, 0], ...(frame.points || []).map((p) => p.map((i) => this.numbers[i]))]) {
        this.widen(this.moved(row, frame, point));
      }
    }
    this.center = this.low.map((l, k) => (l + this.high[k]) / 2);
    this.size = Math.max(1e-9, Math.hypot(...this.low.map((l, k) => this.high[k] - l)) / 2) || 1;
    this.unit = Math.max(0.6, Math.min(this.width / 640, this.height / 480, 1.1));
    const cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), cp = Math.cos(this.pitch), sp = Math.sin(this.pitch);
    // Right, up and towards the eye, for a vertical axis z; `up` names the axis that is vertical.
    const turned = { x: (v) => [v[1], v[2], v[0]], y: (v) => [v[2], v[0], v[1]], z: (v) => v };
    const upright = turned[this.about.up], back = { x: ([a, b, c]) => [c, a, b], y: ([a, b, c]) => [b, c, a], z: (v) => v };
    this.upright = upright;
    this.fromUpright = back[this.about.up];
    const focal = 3.2, scale = 0.55 * Math.min(this.width, this.height * 1.15) * this.zoom / this.size;
    this.scale = scale;
    this.project = (p) => {
      const [x, y, z] = upright(p.map((v, k) => v - this.center[k]));
      const right = cy * y - sy * x, deep = cy * x + sy * y;
      const up = cp * z - sp * deep, near = cp * deep + sp * z;
      const share = focal / Math.max(0.2, focal - near / this.size);
      return [this.width / 2 + scale * share * right, this.height / 2 - scale * share * up, near, share];
    };
  }

  draw(row) {
    this.begin();
    this.fit(row);
    const flat = (p) => this.project(p).slice(0, 2);
    this.ground(flat);
    const floor = this.upright(this.low)[2];
    const shadow = (p) => { const u = [...this.upright(p)]; u[2] = floor; return flat(this.fromUpright(u)); };
    const parts = [];
    const shade = (points, width) => {
      this.pen.globalAlpha = 0.1;
      this.line(points.map(shadow), width, this.ink);
      this.pen.globalAlpha = 1;
    };
    // A rod from one point to another, or a ball, lit from above.
    const rod = (a, b, width, color) => {
      const [p, r] = [a, b].map((x) => this.project(x)), size = width * (p[3] + r[3]) / 2 * this.unit;
      shade([a, b], size);
      parts.push([(p[2] + r[2]) / 2, () => this.tube(p, r, size, color)]);
    };
    const ball = (a, width, color) => {
      const p = this.project(a), size = width * p[3] * this.unit;
      shade([a], size);
      parts.push([p[2] + 1e-3 * this.size, () => this.sphere(p, size, color)]);
    };
    for (const body of this.about.bodies) {
      const center = this.moved(row, body, [0, 0, 0]), color = this.colors[body.name];
      const points = body.points.map((p) => this.moved(row, body, p.map((i) => this.numbers[i])));
      for (const p of points) if (Math.hypot(...p.map((x, i) => x - center[i])) > 1e-9) rod(center, p, 8, color);
      ball(center, points.length ? 17 : 22, color);
    }
    for (const joint of this.about.joints) {
      const at = this.place(row, joint.body, joint.point);
      if (joint.axis) {
        const tip = joint.axis.map((a) => a * 0.06 * this.size), frame = this.frames[joint.body];
        const local = joint.point.map((i) => this.numbers[i]);
        const ends = [-1, 1].map((k) => local.map((x, i) => x + k * tip[i]));
        rod(...ends.map((p) => (frame ? this.moved(row, frame, p) : p)), 11, "#c3ccd5");
      } else ball(at, 12, "#dfe5ea");
    }
    const pins = this.about.pins.map((pin) => this.pin(row, pin));
    for (const bar of this.about.bars) {
      const ends = bar.pins.map((i) => pins[i][0]);
      for (let i = 1; i < ends.length; i++) rod(ends[i - 1], ends[i], 9, this.colors[bar.name]);
    }
    for (const [at, axis] of pins) {
      if (axis) rod(...[-1, 1].map((side) => at.map((x, i) => x + side * 0.06 * this.size * axis[i])), 12, "#c3ccd5");
      else ball(at, 12, "#dfe5ea");
    }
    for (const { kind, first, second } of this.about.ties) {
      const [a, b] = [first, second].map((at) => this.place(row, at.body, at.point));
      parts.push([this.project(a.map((x, i) => (x + b[i]) / 2))[2], () => this.tie(kind, flat(a), flat(b))]);
    }
    this.about.dots.forEach((dot, i) => {
      const at = this.moved(row, dot, [0, 0, 0]), color = this.colors[dot.name];
      const trail = [...this.trails[i], at];
      this.faded(trail.map(flat), color, 2.2 * this.unit);
      ball(at, 20, color);
      const foot = [...this.upright(at)];
      foot[2] = floor;
      const drop = [at, this.fromUpright(foot)];
      parts.push([this.project(drop[1])[2], () => this.line(drop.map(flat), 1, this.color("zero"))]);
    });
    parts.sort((a, b) => a[0] - b[0]).forEach(([, paint]) => paint());
    this.axes(flat);
    if (this.names) {
      for (const frame of [...this.about.bodies, ...this.about.dots]) {
        const [x, y] = flat(this.moved(row, frame, [0, 0, 0]));
        this.text(frame.name, x, y - 18 * this.unit, this.ink, "center", 13);
      }
    }
  }

  tube([ax, ay], [bx, by], width, color) {
    const length = Math.hypot(bx - ax, by - ay) || 1;
    let [nx, ny] = [-(by - ay) / length, (bx - ax) / length];
    if (ny > 0) [nx, ny] = [-nx, -ny];
    const at = (share) => [ax + nx * share * width, ay + ny * share * width];
    const paint = this.pen.createLinearGradient(...at(0.5), ...at(-0.5));
    paint.addColorStop(0, tint(color, 0.06));
    paint.addColorStop(0.3, tint(color, 0.35));
    paint.addColorStop(1, tint(color, -0.35));
    this.line([[ax, ay], [bx, by]], width + 1.6, tint(color, -0.5));
    this.line([[ax, ay], [bx, by]], width, paint);
  }

  sphere([x, y], width, color) {
    const r = width / 2, paint = this.pen.createRadialGradient(x - 0.35 * r, y - 0.4 * r, 0.1 * r, x, y, r);
    paint.addColorStop(0, tint(color, 0.55));
    paint.addColorStop(0.5, color);
    paint.addColorStop(1, tint(color, -0.4));
    this.line([[x, y]], width + 1.6, tint(color, -0.5));
    this.line([[x, y]], width, paint);
  }

  // A grid below all that moves.
  ground(flat) {
    const floor = this.upright(this.low)[2], [mx, my] = this.upright(this.center), cell = nice(this.size / 4);
    const reach = Math.ceil(1.25 * this.size / cell), [i0, j0] = [mx, my].map((m) => Math.round(m / cell));
    for (let i = -reach; i <= reach; i++) {
      for (const k of [0, 1]) {
        const ends = [-reach, reach].map((j) => {
          const at = [(i0 + (k ? j : i)) * cell, (j0 + (k ? i : j)) * cell, floor];
          return flat(this.fromUpright(at));
        });
        this.line(ends, 1, this.color((k ? j0 + i : i0 + i) === 0 ? "zero" : "grid"));
      }
    }
    this.text(`grid ${Number(cell.toPrecision(3))} m`, this.width - 12, this.height - 14, this.color("faint"), "right");
  }

  // Directions of the axes in the lower left corner.
  axes(flat) {
    const origin = flat(this.center);
    ["x", "y", "z"].forEach((name, k) => {
      const step = this.center.map((c, i) => c + (i === k ? 0.05 * this.size : 0)), tip = flat(step);
      const unit = 26 / (0.05 * this.scale * this.size);
      const way = [0, 1].map((i) => (tip[i] - origin[i]) * unit), from = [40, this.height - 40];
      this.line([from, [from[0] + way[0], from[1] + way[1]]], 1.6, this.color("faint"));
      this.text(name, from[0] + way[0] * 1.35, from[1] + way[1] * 1.35, this.color("faint"));
    });
  }

  hit() { return null; }
}

// A colour #rrggbb lighter (up to 1) or darker (down to -1).
function tint(color, by) {
  const parts = [1, 3, 5].map((i) => parseInt(color.slice(i, i + 2), 16));
  return `rgb(${parts.map((c) => Math.round(by > 0 ? c + (255 - c) * by : c * (1 + by))).join(", ")})`;
}

// 1, 2 or 5 times a power of ten, not below what is wanted.
function nice(wanted) {
  const power = 10 ** Math.floor(Math.log10(wanted));
  return [1, 2, 5, 10].map((m) => m * power).find((x) => x >= wanted * (1 - 1e-9));
}

function extent(points) { return Math.max(...points.flatMap((a) => points.map((b) => Math.hypot(a[0] - b[0], a[1] - b[1])))); }

// How far a point is from a line between two others.
function away([x, y], [ax, ay], [bx, by]) {
  const square = (bx - ax) ** 2 + (by - ay) ** 2;
  const share = square ? Math.max(0, Math.min(1, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / square)) : 0;
  return Math.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay));
}

// Corners of the convex hull; the two ends where all points lie on one line.
function hull(points) {
  const ordered = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]), least = 1e-9 * extent(points) ** 2;
  if (ordered.length < 3) return ordered;
  const chain = (some) => {
    const corners = [];
    for (const [x, y] of some) {
      while (corners.length > 1) {
        const [[ax, ay], [bx, by]] = corners.slice(-2);
        if ((bx - ax) * (y - ay) - (by - ay) * (x - ax) > least) break;
        corners.pop();
      }
      corners.push([x, y]);
    }
    return corners.slice(0, -1);
  };
  return [...chain(ordered), ...chain([...ordered].reverse())];
}
