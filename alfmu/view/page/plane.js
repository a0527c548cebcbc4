// The picture of a live page in the plane, by the painter of shared/strokes.js.

const LEAST_TEXT = 11; // smallest text [pixels] that is readable on a phone

class Plane extends Picture {
  constructor(canvas, about) {
    super(canvas, about);
    this.painter = new Painter(canvas.getContext("2d"), {});
    this.painter.least = LEAST_TEXT;
    this.refit();
  }

  shape(numbers) {
    this.scene = resolved(this.about.scene, numbers);
    this.guides = resolved(this.about.guides, numbers);
    this.held = this.scene.front.filter((part) => part.held);
  }

  // Return the poses of all bodies and dots in this row.
  poses(row) {
    const pose = ([x, y, angle]) => ({ x: row[x], y: row[y], angle: angle === undefined ? 0 : row[angle] });
    const moving = Object.entries(this.about.frames).map(([name, { columns }]) => [name, pose(columns)]);
    return { ground: { x: 0, y: 0, angle: 0 }, ...Object.fromEntries(moving) };
  }

  // Convert pixels of the pointer, y downwards, to metres and back.
  metres(x, y) { return [(x - this.fit.origin[0]) / this.fit.scale, (this.height - y - this.fit.origin[1]) / this.fit.scale]; }

  pixels([x, y]) { return [this.fit.origin[0] + this.fit.scale * x, this.height - this.fit.origin[1] - this.fit.scale * y]; }

  // Keep all moving parts in the picture.
  fitted(frames) {
    const at = (anchor) => spot(frames, anchor), { scene } = this;
    for (const { at: places, strokes, guide } of [...scene.back, ...scene.front]) {
      if (guide !== undefined || CORNERS.includes(places[0].body)) continue;
      const { body } = places[0], points = strokes.flatMap((stroke) => (stroke.metres ? stroke.points : []));
      for (const p of [...places, ...points.map(([x, y]) => ({ body, x, y }))].map(at)) {
        for (const k of [0, 1]) {
          if (!Number.isFinite(p[k])) continue;
          this.low[k] = Math.min(this.low[k], p[k]);
          this.high[k] = Math.max(this.high[k], p[k]);
        }
      }
    }
    this.guides.forEach(({ base, rider, axis = 0 }, i) => {
      const [x, y] = at(base), [rx, ry] = at(rider), turn = frames[base.body].angle + axis;
      const along = (rx - x) * Math.cos(turn) + (ry - y) * Math.sin(turn), range = this.travel[i];
      if (Number.isFinite(along)) this.travel[i] = [Math.min(range[0], along), Math.max(range[1], along)];
    });
    const base = Math.max(0.62, Math.min(this.width / 640, this.height / 480, 1.25));
    const margin = 104 * base, old = this.whole ? null : this.fit;
    this.whole = false;
    let spans = [0, 1].map((k) => this.high[k] - this.low[k]);
    if (Math.max(...spans) < 1e-9) spans = [1, 1];
    const room = [this.width - margin, this.height - margin];
    let scale = Math.min(...[0, 1].filter((k) => spans[k] > 1e-12).map((k) => room[k] / spans[k]));
    if (this.grabbed && old) return old; // the dragged body stays under the pointer
    // Approach the fitting scale gradually, or at once if much would be cut off.
    const far = old ? Math.abs(Math.log(scale / old.scale)) : Infinity, ease = far < 0.7 && old.size[0] === this.width ? 0.2 : 1;
    this.settling = ease < 1 && far > 1e-3; // the next picture continues this
    if (ease < 1) scale = old.scale * (scale / old.scale) ** ease;
    const center = [0, 1].map((k) => (this.low[k] + this.high[k]) / 2);
    let origin = [this.width / 2 - scale * center[0], this.height / 2 - 6 * base - scale * center[1]];
    if (ease < 1) origin = old.origin.map((m, k) => m + ease * (origin[k] - m));
    const lines = this.held.map(({ strokes }) => strokes[0]).filter(({ metres, points }) => metres && points.length > 1);
    const lengths = lines.map(({ points }) => scale * extent(points)).sort((a, b) => a - b);
    const usual = lengths.length ? lengths[lengths.length >> 1] : 80 * base;
    return { size: [this.width, this.height], scale, origin, base, unit: base * Math.min(1, Math.max(0.3, usual / (80 * base))),
      cell: nice(70 * base / scale), travel: this.travel };
  }

  // Return to the view in which the page was opened.
  refit() {
    this.low = [...this.about.low];
    this.high = [...this.about.high];
    this.travel = this.about.travel.map((range) => [...range]);
    this.whole = true;
  }

  draw(row) {
    const frames = this.poses(row), { painter, canvas } = this, { pen } = painter;
    if (this.resized()) [canvas.width, canvas.height] = [this.width, this.height].map((x) => Math.round(x * devicePixelRatio));
    painter.palette = this.palette();
    this.fit = { ...this.fitted(frames), names: this.names };
    pen.setTransform(devicePixelRatio, 0, 0, -devicePixelRatio, 0, this.height * devicePixelRatio);
    pen.fillStyle = painter.palette.paper;
    pen.fillRect(0, 0, this.width, this.height);
    painter.paint(this.scene, this.fit, frames, () => this.about.dots.forEach((name, i) => {
      const points = this.trails[i].map(([x, y]) => painter.place({ body: "ground", x, y }));
      this.faded([...points, painter.place({ body: name })], this.scene.colors[name]);
    }));
    if (this.pulled) {
      const { name, x, y, to } = this.pulled, from = painter.place({ body: name, x, y });
      pen.setLineDash([4, 4]);
      painter.line([from, [to[0], this.height - to[1]]], 1.5, painter.color("accent"));
      pen.setLineDash([]);
      painter.line([from], 9, painter.color("accent"));
    }
  }

  faded(trail, color) {
    const pieces = 12, length = Math.ceil(trail.length / pieces), { pen } = this.painter;
    for (let k = 0; k < pieces; k++) {
      const piece = trail.slice(k * length, (k + 1) * length + 1);
      if (piece.length < 2) continue;
      pen.globalAlpha = 0.15 + 0.65 * (k + 1) / pieces;
      this.painter.line(piece, 2.5 * this.fit.unit, color);
    }
    pen.globalAlpha = 1;
  }

  // Return the body under the pointer with its point there; null if there is none.
  hit(row, x, y) {
    const near = [], frames = this.poses(row);
    for (const { at: [{ body }], strokes: [outline, ...more] } of this.held) {
      const pixels = ([px, py]) => this.pixels(spot(frames, { body, x: px, y: py }));
      const points = (outline.metres ? hull(outline.points) : [[0, 0]]).map(pixels);
      const ends = points.length > 1 ? points.map((p, i) => [p, points[(i + 1) % points.length]]) : [[points[0], points[0]]];
      if (more.length) ends.push([1, 1].map(() => pixels([0, 0])));
      near.push([Math.min(...ends.map(([a, b]) => away([x, y], a, b))) / (points.length > 2 ? 2 : 1), body]);
    }
    near.sort((a, b) => a[0] - b[0]);
    if (!near.length || near[0][0] > 22) return null;
    const name = near[0][1], { columns } = this.about.frames[name], pose = frames[name], [mx, my] = this.metres(x, y);
    if (columns.length < 3) return { name, columns, x: 0, y: 0 };
    const [px, py] = turned({ angle: -pose.angle }, mx - pose.x, my - pose.y);
    return { name, columns, x: px, y: py };
  }
}

function extent(points) { return Math.max(...points.flatMap((a) => points.map((b) => Math.hypot(a[0] - b[0], a[1] - b[1])))); }

// Return the distance of a point from the line between two others.
function away([x, y], [ax, ay], [bx, by]) {
  const square = (bx - ax) ** 2 + (by - ay) ** 2;
  const share = square ? Math.max(0, Math.min(1, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / square)) : 0;
  return Math.hypot(x - ax - share * (bx - ax), y - ay - share * (by - ay));
}
