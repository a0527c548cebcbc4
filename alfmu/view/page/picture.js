// Pictures of a mechanism on a canvas: one of the plane, one of space. Parameters change while the page is open, so the
// scene that plane.py makes of a film's shapes once is made here for each picture; shared/strokes.js paints both. Both take the numbers of its shapes (`numbers`, what
// the page's function `geometry` gives for the parameters as they are) and a row of outputs.

const COLORS = ["#6b9bc7", "#e3b05f", "#76b18f", "#d0826f", "#9d8fc6", "#58a9ae", "#c98ca9", "#9aa4ae"];

const TRAIL = 600; // places that a trail keeps

const DARK = "#2b3440"; // the rim of a white pin, on a dark page too

const LEAST_TEXT = 11; // pixels: what a phone shows stays readable

class Canvas extends Painter {
  constructor(canvas, about) {
    super(canvas.getContext("2d"), "");
    this.canvas = canvas;
    this.about = about;
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
    pen.fillStyle = this.paper = this.color("paper");
    pen.fillRect(0, 0, width, height);
  }

  // A stroke whose width is in units.
  stroke(points, width = 2, color = this.ink, filled = false) { return { points, width: width * this.unit, color, filled }; }

  // A line or area of `width` pixels with a rim.
  outlined(points, width, color, filled = false, rim = this.shade(color)) {
    return [{ points, width: width + 3.2 * this.unit, color: rim, filled }, { points, width, color, filled }];
  }

  // The rim of a colour: darker on a light page, lighter on a dark one.
  shade(color) {
    const part = (i) => Math.min(255, Math.floor(parseInt(color.slice(i, i + 2), 16) * this.rim));
    return `#${[1, 3, 5].map((i) => part(i).toString(16).padStart(2, "0")).join("")}`;
  }

  // A rod, a spring, a damper or both from one point to another.
  tie(kind) {
    const u = this.unit, offset = kind === "spring-damper" ? 9 * u : 0, strokes = [];
    if (kind === "rod") {
      const end = (x) => this.outlined([[x, 0]], 8 * u, this.color("white"), false, DARK);
      return [this.stroke([[0, 0], [1, 0]], 4), ...end(0), ...end(1)];
    }
    if (kind.includes("spring")) {
      const teeth = Array.from({ length: 13 }, (_, i) => [0.26 + 0.04 * i, offset + (i % 2 ? 7 : -7) * u]);
      const coil = [[0, 0], [0.15, 0], [0.15, offset], [0.23, offset], ...teeth];
      strokes.push(this.stroke([...coil, [0.77, offset], [0.85, offset], [0.85, 0], [1, 0]]));
    }
    if (kind.includes("damper")) {
      const y = -offset, r = 6 * u;
      strokes.push(this.stroke([[0, 0], [0.15, 0], [0.15, y], [0.38, y]]));
      strokes.push(this.stroke([[0.62, y + r], [0.38, y + r], [0.38, y - r], [0.62, y - r]]));
      strokes.push(this.stroke([[0.52, y + r / 2], [0.52, y - r / 2]], 3));
      strokes.push(this.stroke([[0.52, y], [0.85, y], [0.85, 0], [1, 0]]));
    }
    return [...strokes, this.stroke([[0, 0]], 6), this.stroke([[1, 0]], 6)];
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
    this.refit();
    const key = (a) => `${a.body} ${a.x} ${a.y}`;
    const once = (some) => [...new Map(some.map((a) => [key(a), a])).values()];
    // Hinges, welds and pins; those that share a point are one.
    this.places = [];
    for (const joint of about.joints) {
      if (joint.kind === "prismatic" || joint.kind === "distance") continue;
      const pin = joint.kind === "point_on_line", anchors = pin ? [joint.second] : [joint.first, joint.second];
      const knot = { names: pin || !joint.name ? [] : [joint.name], kind: joint.kind, anchors };
      const shared = this.places.filter((k) => k.anchors.some((a) => anchors.some((b) => key(a) === key(b))));
      for (const other of shared) {
        knot.names.unshift(...other.names);
        knot.anchors = once([...other.anchors, ...knot.anchors]);
        knot.kind = other.kind;
        this.places.splice(this.places.indexOf(other), 1);
      }
      this.places.push(knot);
    }
    const held = about.joints.filter((j) => ["revolute", "weld", "distance"].includes(j.kind))
      .map((j) => ({ ...j.first, legs: j.kind !== "weld" }));
    const ties = about.ties.filter((tie) => tie.kind !== "spiral").flatMap((tie) => [tie.first, tie.second]);
    held.push(...ties.map((at) => ({ ...at, legs: true })));
    this.ground = once(held.filter(({ body }) => body === "ground"));
  }

  shape(numbers) {
    const at = (a) => ({ ...a, x: numbers[a.x], y: numbers[a.y] });
    const ends = (of) => ({ ...of, first: at(of.first), second: at(of.second) });
    this.links = this.about.links.map((link) => ({ ...link, points: link.points.map(([x, y]) => [numbers[x], numbers[y]]) }));
    for (const link of this.links) link.hull = hull(link.points);
    this.rims = this.about.rims.map((rim) => ({ ...rim, points: rim.points.map(([x, y]) => [numbers[x], numbers[y]]) }));
    this.guides = this.about.guides.map((g) => ({ ...g, base: at(g.base), rider: at(g.rider), axis: numbers[g.axis],
      block: g.block === null ? null : numbers[g.block] }));
    this.ties = this.about.ties.map(ends);
    this.knots = this.places.map((knot) => ({ ...knot, anchors: knot.anchors.map(at) }));
    this.supports = this.ground.map(at);
  }

  // Poses of all bodies and dots in this row.
  frames(row) {
    const pose = ([x, y, angle]) => ({ x: row[x], y: row[y], angle: angle === undefined ? 0 : row[angle] });
    const moving = Object.entries(this.columns).map(([name, columns]) => [name, pose(columns)]);
    return { ground: { x: 0, y: 0, angle: 0 }, ...Object.fromEntries(moving) };
  }

  // Metres where the pointer is, and back; its y points downwards.
  metres(x, y) { return [(x - this.origin[0]) / this.scale, (this.height - y - this.origin[1]) / this.scale]; }

  pixels([x, y]) { return [this.origin[0] + this.scale * x, this.height - this.origin[1] - this.scale * y]; }

  // Keep all that moves in the picture.
  fit(frames) {
    const at = (a) => placed(METRES, frames, a);
    const points = this.links.flatMap((link) => link.points.map(([x, y]) => at({ body: link.name, x, y })));
    points.push(...this.rims.flatMap(({ body, points }) => points.map(([x, y]) => at({ body, x, y }))));
    points.push(...this.supports.map(at), ...this.about.dots.map(({ name }) => at({ body: name, x: 0, y: 0 })));
    for (const p of points) {
      for (const k of [0, 1]) {
        if (!Number.isFinite(p[k])) continue;
        this.low[k] = Math.min(this.low[k], p[k]);
        this.high[k] = Math.max(this.high[k], p[k]);
      }
    }
    this.guides.forEach(({ base, rider, axis }, i) => {
      const [x, y] = at(base), [rx, ry] = at(rider), turn = frames[base.body].angle + axis;
      const along = (rx - x) * Math.cos(turn) + (ry - y) * Math.sin(turn), range = this.travel[i];
      if (Number.isFinite(along)) this.travel[i] = [Math.min(range[0], along), Math.max(range[1], along)];
    });
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
    const origin = [this.width / 2 - this.scale * center[0], this.height / 2 - 6 * base - this.scale * center[1]];
    this.origin = this.origin && ease < 1 ? this.origin.map((m, k) => m + ease * (origin[k] - m)) : origin;
    const lengths = this.links.filter((l) => l.points.length > 1).map((l) => this.scale * extent(l.points)).sort((a, b) => a - b);
    const usual = lengths.length ? lengths[lengths.length >> 1] : 80 * base;
    this.base = base;
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
    const frames = this.frames(row);
    this.begin();
    this.fit(frames);
    this.pen.transform(1, 0, 0, -1, 0, this.height);
    const scene = this.scene(), pixels = ([x, y]) => placed(scene, frames, { body: "ground", x, y });
    this.paint(scene, frames, () => this.about.dots.forEach(({ name }, i) => {
      const trail = [...this.trails[i], [frames[name].x, frames[name].y]];
      this.faded(trail.map(pixels), this.colors[name], 2.5 * this.unit);
    }));
    if (this.pulled) {
      const [x, y] = this.pulled.to, from = placed(scene, frames, { ...this.pulled, body: this.pulled.name });
      this.pen.setLineDash([4, 4]);
      this.line([from, [x, this.height - y]], 1.5, this.color("accent"));
      this.pen.setLineDash([]);
      this.line([from], 9, this.color("accent"));
    }
  }

  // What plane.py makes of the same shapes (`scene_of`), by the same rules in the same order.
  scene() {
    const back = [this.grid(), this.marks(), ...this.supports.map((at) => this.support(at))];
    const rims = (filled) => this.rims.filter((rim) => rim.filled === filled).map((rim) => this.wheel(rim));
    const front = [...rims(true), ...this.links.map((link) => this.link(link)), ...rims(false)];
    this.guides.forEach((guide, i) => (guide.base.body === "ground" ? back : front).push(...this.guide(guide, this.travel[i])));
    front.push(...this.ties.map((tie) => this.tied(tie)), ...this.knots.map((knot) => this.knot(knot)));
    const dots = this.about.dots.map(({ name }) => ({ body: name, x: 0, y: 0 }));
    front.push(...dots.map((at) => part([at], this.outlined([[0, 0]], 14 * this.unit, this.colors[at.body]))));
    const labels = this.markLabels();
    if (this.names) {
      labels.push(...this.ties.filter((tie) => tie.name).map((tie) => this.named(tie.name, [tie.first, tie.second], [], 5)));
      labels.push(...dots.map((at) => this.named(at.body, [at], [], 10)));
      labels.push(...this.guides.map((guide, i) => this.guideLabel(guide, this.travel[i])));
      labels.push(...this.links.map((link) => this.linkLabel(link)));
      labels.push(...this.knots.filter((knot) => knot.names.length).map((knot) => this.knotLabel(knot)));
    }
    const pins = [...this.knots.map((knot) => knot.anchors[0]), ...dots];
    return { size: [this.width, this.height], scale: this.scale, origin: this.origin, unit: this.unit, back, front, labels,
      pins, pin: 6 * this.unit };
  }

  // Distance of grid lines [m].
  get cell() { return nice(70 * this.base / this.scale); }

  // A place so many `base` pixels from the left lower corner (x < 0: the right one), seen from the origin.
  corner(x, y) { return [x * this.base + (x < 0 ? this.width : 0) - this.origin[0], y * this.base - this.origin[1]]; }

  grid() {
    const step = this.scale * this.cell, size = [this.width, this.height], lines = [];
    for (const k of [0, 1]) {
      const low = -this.origin[1 - k], high = size[1 - k] - this.origin[1 - k];
      for (let i = Math.ceil(-this.origin[k] / step); i <= (size[k] - this.origin[k]) / step; i++) {
        const points = k === 0 ? [[i * step, low], [i * step, high]] : [[low, i * step], [high, i * step]];
        lines.push({ points, width: this.base, color: this.color(i ? "grid" : "zero"), filled: false, zero: i === 0 });
      }
    }
    return part(ORIGIN, lines.sort((a, b) => a.zero - b.zero));
  }

  marks() {
    const u = this.base, [x, y] = this.corner(24, 24), [right] = this.corner(-24, 24), color = this.color("faint");
    const left = right - this.scale * this.cell;
    const lines = [[[x, y + 30 * u], [x, y], [x + 30 * u, y]], [[left, y], [right, y]],
      ...[left, right].map((end) => [[end, y - 4 * u], [end, y + 4 * u]])];
    const tips = [[[36, 0], [28, 3], [28, -3]], [[0, 36], [3, 28], [-3, 28]]];
    return part(ORIGIN, [
      ...lines.map((points) => ({ points, width: 1.5 * u, color, filled: false })),
      ...tips.map((tip) => ({ points: tip.map(([dx, dy]) => [x + dx * u, y + dy * u]), width: u, color, filled: true })),
    ]);
  }

  markLabels() {
    const [right, y] = this.corner(-24, 36), long = `${Number(this.cell.toPrecision(6))} m`;
    const texts = [["x", this.corner(70, 24)], ["y", this.corner(24, 70)], [long, [right - this.scale * this.cell / 2, y]]];
    return texts.map(([text, [px, py]]) => ({ text, at: [{ body: "ground", x: px / this.scale, y: py / this.scale }], links: [],
      gap: 0, size: Math.max(LEAST_TEXT, 12 * this.base), color: this.color("faint"), free: false }));
  }

  support(at) {
    const u = this.unit, foot = (at.legs ? -24 : -9) * u;
    const strokes = [...this.hatch(-24 * u, 24 * u, foot), this.stroke([[-24 * u, foot], [24 * u, foot]])];
    if (at.legs) strokes.push(...this.outlined([[0, 0], [-13 * u, foot], [13 * u, foot]], 2 * u, this.color("steel"), true, this.ink));
    return part([at], strokes);
  }

  guide(guide, travel) {
    const u = this.unit, half = this.half(guide), grounded = guide.base.body === "ground", faint = this.color("faint");
    const [low, high] = travel.map((end, k) => end * this.scale + (k ? 50 : -50) * u);
    const strokes = [this.stroke([[low, -half], [high, -half]])];
    if (grounded) strokes.push(...this.hatch(low, high, -half));
    if (!grounded || guide.block === null) strokes.push(this.stroke([[low, half], [high, half]]));
    for (let i = 0; low + 20 * u * i < high; i++) {
      const x = low + 20 * u * i;
      strokes.push(this.stroke([[x, 0], [x + 10 * u, 0]], 1, faint), this.stroke([[x + 15 * u, 0]], 1.5, faint));
    }
    const rails = part([guide.base], strokes, guide.axis);
    if (guide.block === null) return [rails];
    const x = 24 * u, y = half - 2 * u, corners = [[-x, -y], [x, -y], [x, y], [-x, y]];
    return [rails, part([guide.rider], this.outlined(corners, 4 * u, this.colors[guide.rider.body], true), guide.block)];
  }

  wheel({ body, points, filled }) {
    const ink = body === "ground" ? this.ink : undefined, color = this.colors[body] || this.color("steel");
    const line = points.map(([x, y]) => [x * this.scale, y * this.scale]);
    return part([{ body, x: 0, y: 0 }], this.outlined(line, (filled ? 2 : 4) * this.unit, color, filled, ink));
  }

  link(link) {
    const u = this.unit, color = this.colors[link.name], strokes = [];
    const points = link.hull.map(([x, y]) => [x * this.scale, y * this.scale]);
    if (points.length > 1) strokes.push(...this.outlined(points, (link.kind === "mass" ? 8 : 14) * u, color, points.length > 2));
    if (link.kind === "mass") strokes.push(...this.outlined([[0, 0]], 28 * u, color));
    return part([{ body: link.name, x: 0, y: 0 }], strokes);
  }

  knot({ kind, anchors }) {
    const u = this.unit;
    if (kind !== "weld") return part([anchors[0]], this.outlined([[0, 0]], 13 * u, this.color("white"), false, DARK));
    const square = [[-3, -3], [3, -3], [3, 3], [-3, 3]].map(([x, y]) => [x * u, y * u]);
    return part([anchors[0]], [this.stroke(square, 2, this.ink, true)]);
  }

  tied({ kind, first, second }) {
    if (kind !== "spiral") return part([first, second], this.tie(kind));
    const points = Array.from({ length: 61 }, (_, i) => {
      const t = 5 * Math.PI * i / 60, r = (10 + 0.7 * t) * this.unit;
      return [r * Math.cos(t), r * Math.sin(t)];
    });
    return part([first], [this.stroke(points, 1.5)]);
  }

  named(text, at, links, gap, size = 14, color = this.ink) {
    return { text, at, links, gap: gap * this.unit, size: Math.max(LEAST_TEXT, size * this.unit), color, free: true };
  }

  // On the side that links, rails and ground leave free.
  knotLabel({ names, anchors }) {
    const at = (a, b) => a.body === b.body && a.x === b.x && a.y === b.y;
    const links = anchors.filter((a) => a.body === "ground").map(() => ({ body: "ground", x: 0, y: -1 }));
    for (const a of anchors) {
      const { points = [] } = this.links.find((link) => link.name === a.body) || {};
      for (const [x, y] of points) {
        if (x === a.x && y === a.y) continue;
        const length = Math.hypot(x - a.x, y - a.y);
        links.push({ body: a.body, x: (x - a.x) / length, y: (y - a.y) / length });
      }
    }
    const blocks = this.guides.filter((g) => g.block !== null && anchors.some((a) => at(a, g.rider)));
    links.push(...blocks.map((g) => ({ body: g.rider.body, x: Math.sin(g.block), y: -Math.cos(g.block) })));
    const spirals = this.ties.some((tie) => tie.kind === "spiral" && anchors.some((a) => at(a, tie.first)));
    return this.named(names.join(", "), [anchors[0]], links, blocks.length || spirals ? 26 : 11);
  }

  // Under the beginning of the rails.
  guideLabel(guide, travel) {
    const along = travel[0] - 50 * this.unit / this.scale, c = Math.cos(guide.axis), s = Math.sin(guide.axis);
    const at = { body: guide.base.body, x: guide.base.x + c * along, y: guide.base.y + s * along };
    return this.named(guide.name, [at], [{ body: at.body, x: -s, y: c }], this.half(guide) / this.unit + 12);
  }

  // Beside the longest free stretch of a bar, in the middle of a plate, under a block.
  linkLabel(link) {
    const on = (points) => points.map(([x, y]) => ({ body: link.name, x, y })), corners = link.hull;
    const label = (at, away, gap) => this.named(link.name, on(at), on(away), gap, 13, this.shade(this.colors[link.name]));
    const guide = this.guides.find((g) => link.kind === "block" && g.rider.body === link.name && g.block !== null);
    if (guide) {
      const up = [-Math.sin(guide.block), Math.cos(guide.block)];
      return label([[guide.rider.x, guide.rider.y]], [up], this.half(guide) / this.unit + 12);
    }
    if (corners.length === 1) return label(corners, [], 18);
    if (corners.length > 2) return label(corners, [], 0);
    const [a, b] = corners, length = Math.hypot(b[0] - a[0], b[1] - a[1]);
    let [ex, ey] = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
    if (ex < 0 || (ex === 0 && ey < 0)) [ex, ey] = [-ex, -ey];
    const points = [...link.points].sort((p, q) => p[0] - q[0] || p[1] - q[1]);
    const size = (i) => Math.round(1e9 * Math.hypot(points[i + 1][0] - points[i][0], points[i + 1][1] - points[i][1]));
    let widest = 0;
    for (let i = 1; i + 1 < points.length; i++) if (size(i) > size(widest)) widest = i;
    return label(points.slice(widest, widest + 2), [[ey, -ex]], 15);
  }

  hatch(low, high, y) {
    const u = this.unit, strokes = [];
    for (let i = 1; low + 7 * u * i < high; i++) {
      const x = low + 7 * u * i;
      strokes.push(this.stroke([[x, y], [x - 7 * u, y - 8 * u]], 1.2, this.color("faint")));
    }
    return strokes;
  }

  half(guide) { return (guide.block === null ? 9 : 15) * this.unit; }

  // The body under the pointer, and its point there; null where there is none.
  hit(row, x, y) {
    const near = [], frames = this.frames(row);
    const pixels = (body, [px, py]) => this.pixels(placed(METRES, frames, { body, x: px, y: py }));
    for (const link of this.links) {
      const points = link.hull.map((p) => pixels(link.name, p));
      const ends = points.length > 1 ? points.map((p, i) => [p, points[(i + 1) % points.length]]) : [[points[0], points[0]]];
      if (link.kind === "mass") ends.push([1, 1].map(() => pixels(link.name, [0, 0])));
      near.push([Math.min(...ends.map(([a, b]) => away([x, y], a, b))) / (points.length > 2 ? 2 : 1), link]);
    }
    for (const dot of this.about.dots) near.push([away([x, y], ...[1, 1].map(() => pixels(dot.name, [0, 0]))), dot]);
    near.sort((a, b) => a[0] - b[0]);
    if (!near.length || near[0][0] > 22) return null;
    const { name, columns } = near[0][1], pose = frames[name], [mx, my] = this.metres(x, y);
    if (columns.length < 3) return { name, columns, x: 0, y: 0 };
    const [px, py] = turned({ angle: -pose.angle }, mx - pose.x, my - pose.y);
    return { name, columns, x: px, y: py };
  }
}

const METRES = { origin: [0, 0], scale: 1 };

const ORIGIN = [{ body: "ground", x: 0, y: 0 }];

function part(at, strokes, angle = 0) { return { at, strokes, angle }; }

class Space extends Canvas {
  constructor(canvas, about) {
    super(canvas, about);
    // Right, up and towards the eye, for a vertical axis z; `up` names the axis that is vertical.
    const turned = { x: (v) => [v[1], v[2], v[0]], y: (v) => [v[2], v[0], v[1]], z: (v) => v };
    const back = { x: ([a, b, c]) => [c, a, b], y: ([a, b, c]) => [b, c, a], z: (v) => v };
    this.upright = turned[about.up];
    this.fromUpright = back[about.up];
    this.home();
    this.frames = Object.fromEntries([...about.bodies, ...about.dots].map((b) => [b.name, b]));
  }

  home() {
    Object.assign(this, { yaw: -0.95, pitch: 0.38, zoom: 1, reach: this.about.reach });
    this.low = [...this.about.low];
    this.high = [...this.about.high];
    this.axis = this.upright(this.low.map((l, k) => (l + this.high[k]) / 2));
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
    const [x, y] = this.upright(point), away = Math.hypot(x - this.axis[0], y - this.axis[1]);
    if (Number.isFinite(away)) this.reach = Math.max(this.reach, away);
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
    const [floor, ceiling] = [this.low, this.high].map((p) => this.upright(p)[2]), tall = (ceiling - floor) / 2;
    this.center = this.fromUpright([this.axis[0], this.axis[1], floor + tall]);
    this.size = Math.max(1e-9, Math.hypot(this.reach, tall)) || 1;
    this.unit = Math.max(0.6, Math.min(this.width / 640, this.height / 480, 1.1));
    const cy = Math.cos(this.yaw), sy = Math.sin(this.yaw), cp = Math.cos(this.pitch), sp = Math.sin(this.pitch), focal = 3.2;
    const share = (near) => focal / Math.max(0.2, focal - near / this.size);
    // All that moves is in a cylinder about the vertical axis, which fits however the picture is turned.
    let [wide, top, bottom] = [1e-9, 1e-9, -1e-9];
    for (let i = 0; i < 48; i++) {
      const deep = this.reach * Math.cos(i * Math.PI / 24), z = i % 2 ? tall : -tall;
      const near = share(cp * deep + sp * z), up = near * (cp * z - sp * deep);
      wide = Math.max(wide, near * this.reach * Math.abs(Math.sin(i * Math.PI / 24)));
      [top, bottom] = [Math.max(top, up), Math.min(bottom, up)];
    }
    const room = 30 * this.unit; // for balls and axes of joints
    const scale = this.zoom * Math.min((this.width / 2 - room) / wide, (this.height - 2 * room) / (top - bottom));
    const middle = this.height / 2 + scale * (top + bottom) / 2;
    this.scale = scale;
    this.project = (p) => {
      const [x, y, z] = this.upright(p.map((v, k) => v - this.center[k]));
      const right = cy * y - sy * x, deep = cy * x + sy * y;
      const up = cp * z - sp * deep, near = cp * deep + sp * z;
      const by = share(near);
      return [this.width / 2 + scale * by * right, middle - scale * by * up, near, by];
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
        const tip = joint.axis.map((i) => this.numbers[i] * 0.06 * this.size), frame = this.frames[joint.body];
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
      parts.push([this.project(a.map((x, i) => (x + b[i]) / 2))[2], () => this.between(flat(a), flat(b), this.tie(kind))]);
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
        this.text(frame.name, x, y - 18 * this.unit, 13, this.ink);
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
    this.text(`grid ${Number(cell.toPrecision(3))} m`, this.width - 12, this.height - 14, 12, this.color("faint"), "right");
  }

  // Directions of the axes in the lower left corner.
  axes(flat) {
    const origin = flat(this.center);
    ["x", "y", "z"].forEach((name, k) => {
      const step = this.center.map((c, i) => c + (i === k ? 0.05 * this.size : 0)), tip = flat(step);
      const unit = 26 / (0.05 * this.scale * this.size);
      const way = [0, 1].map((i) => (tip[i] - origin[i]) * unit), from = [40, this.height - 40];
      this.line([from, [from[0] + way[0], from[1] + way[1]]], 1.6, this.color("faint"));
      this.text(name, from[0] + way[0] * 1.35, from[1] + way[1] * 1.35, 12, this.color("faint"));
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
  const spans = [0, 1].map((k) => Math.max(...points.map((p) => p[k])) - Math.min(...points.map((p) => p[k])));
  const ordered = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]).filter((p, i, all) =>
    !i || p[0] !== all[i - 1][0] || p[1] !== all[i - 1][1]), least = 1e-9 * Math.max(...spans) ** 2;
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
