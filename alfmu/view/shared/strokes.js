// Pictures in the plane for films and live pages: a painter on a canvas, and placement of labels. It paints scenes
// (`Scene` of scene.py) at the scale of a `fit` (`Fit` of plane.py), by the rules of plane.py (`_Painter`): parts move with
// frames {x, y [m], angle [rad]} by name. Empty fields are missing in the data.

const PUSHED = 2.5; // largest displacement of a label by others in its half sizes, as in surface.py

const OVERHANG = 50, CORNERS = ["left corner", "right corner"], RULER = -1; // as in scene.py

class Painter {
  // `palette` has colours by name, including `paper`, and `rim`, the brightness of a rim over that of its colour.
  constructor(pen, palette) {
    this.pen = pen;
    this.palette = palette;
    this.least = 0; // smallest size of a text [pixels]
  }

  color(name) { return this.palette[name] || name; }

  // Return the rim of a colour: darker on a light page, lighter on a dark one; the rim of white is always dark.
  rim(name) {
    if (name === "white") return "#2b3440";
    if (name === "steel" || name === "faint") return this.palette.ink;
    const color = this.color(name), { rim } = this.palette;
    const part = (i) => Math.min(255, Math.floor(parseInt(color.slice(i, i + 2), 16) * rim));
    return `#${[1, 3, 5].map((i) => part(i).toString(16).padStart(2, "0")).join("")}`;
  }

  // Paint a line with round ends: a disc if it has one point, an area if it is filled.
  line(points, width, color, filled = false) {
    const pen = this.pen;
    pen.lineCap = pen.lineJoin = "round";
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

  // Paint a text with a rim, about its middle or beside a point, in the axes of the pen.
  text(text, x, y, size, color, align = "center") {
    const pen = this.pen;
    this.font(size);
    pen.textAlign = align;
    pen.textBaseline = "middle";
    pen.save();
    pen.translate(x, y);
    pen.scale(1, Math.sign(pen.getTransform().d));
    pen.lineJoin = "round";
    pen.lineWidth = 2 * size / 7;
    pen.strokeStyle = this.palette.paper;
    pen.strokeText(text, 0, 0);
    pen.fillStyle = color;
    pen.fillText(text, 0, 0);
    pen.restore();
  }

  font(size) { this.pen.font = `${size}px {{fonts}}`; }

  // Return half the width and height of the box of a text.
  box(text, size) {
    this.font(size);
    return [this.pen.measureText(text).width / 2 + 2, 0.55 * size + 1];
  }

  // Paint a scene at given frames; `trails` paints between its back and its front. y points upwards.
  paint(scene, fit, frames, trails) {
    Object.assign(this, { fit, frames });
    this.grid();
    scene.back.forEach((each) => this.part(each));
    trails();
    scene.front.forEach((each) => this.part(each));
    const pins = scene.pins.map((at) => [...this.place(at), 6 * fit.unit]);
    const labels = scene.labels.filter((l) => fit.names || !l.free).map((l) => this.label(l));
    const fixed = labels.filter((l) => !l.free), free = labels.filter((l) => l.free);
    fixed.forEach((l) => this.text(l.text, l.box[0], l.box[1], l.size, l.color));
    this.texts(free, free.map((l) => l.box), pins, fit.size);
  }

  grid() {
    const { origin, scale, cell, size, base } = this.fit, step = scale * cell, lines = [];
    for (const k of [0, 1]) {
      for (let i = Math.ceil(-origin[k] / step); i <= (size[k] - origin[k]) / step; i++) {
        const at = origin[k] + i * step;
        lines.push([i === 0, k === 0 ? [[at, 0], [at, size[1]]] : [[0, at], [size[0], at]]]);
      }
    }
    lines.sort((a, b) => a[0] - b[0]).forEach(([zero, line]) => this.line(line, base, this.color(zero ? "zero" : "grid")));
  }

  // Return a point of a body, or of a corner of the picture, in pixels.
  place({ body, x = 0, y = 0 }) {
    const { origin, scale, base, size } = this.fit, corner = CORNERS.indexOf(body);
    if (corner >= 0) return [corner * size[0] + base * x, base * y];
    return spot(this.frames, { body, x, y }).map((q, k) => origin[k] + scale * q);
  }

  // Return the position of a part or label, the direction of its x axis, the start and end of x in pixels, and the unit.
  way({ at, angle = 0, guide }, two = at.length > 1) {
    const { scale, base, unit: usual, cell, travel } = this.fit, { body } = at[0];
    const unit = CORNERS.includes(body) ? base : usual, start = this.place(at[0]);
    if (two) {
      const end = this.place(at[1]), way = end.map((q, k) => q - start[k]), length = Math.hypot(...way);
      return [start, way.map((q) => q / (length || 1)), [0, length], unit];
    }
    const turn = angle + (this.frames[body] ? this.frames[body].angle : 0);
    let range = [0, unit];
    if (guide === RULER) range = [-cell * scale, 0];
    else if (guide !== undefined) range = travel[guide].map((end, k) => scale * end + (k ? OVERHANG : -OVERHANG) * unit);
    return [start, [Math.cos(turn), Math.sin(turn)], range, unit];
  }

  part(part) {
    const [[ox, oy], [ax, ay], [low, high], unit] = this.way(part), { scale, unit: rim } = this.fit;
    for (const { points, width = 0, color, filled, rim: rimmed, every, metres } of part.strokes) {
      let lines = [points.map(([x, y]) => [low + x * (high - low), y * unit])], full = filled;
      if (every) {
        const count = Math.max(0, Math.ceil(Number(((high - low) / unit - points[0][0]).toFixed(9)) / every));
        lines = Array.from({ length: count }, (_, i) => points.map(([x, y]) => [low + (every * i + x) * unit, y * unit]));
      } else if (metres) {
        const corners = metres === "hull" ? hull(points) : points;
        full = filled || (metres === "hull" && corners.length > 2);
        lines = [corners.map(([x, y]) => [x * scale, y * scale])];
      }
      if (!width) continue;
      for (const line of lines) {
        const there = line.map(([x, y]) => [ox + x * ax - y * ay, oy + x * ay + y * ax]);
        if (rimmed) this.line(there, width * unit + 3.2 * rim, this.rim(color), full);
        this.line(there, width * unit, this.color(color), full);
      }
    }
  }

  // Return the text of a label, its size, and its preferred box.
  label(label) {
    const [start, axis, [low, high], unit] = this.way(label, false), { at, guide, gap = 0, links = [], share = 0, free } = label;
    const text = label.text || `${Number(this.fit.cell.toPrecision(6))} m`, size = Math.max(this.least, label.size * unit);
    const places = at.map((a) => this.place(a)), [half, tall] = this.box(text, size);
    let [x, y] = [0, 1].map((k) => (guide === undefined ? places.reduce((sum, p) => sum + p[k], 0) / places.length
      : start[k] + (low + share * (high - low)) * axis[k]));
    if (gap) {
      const [dx, dy] = widest(links.map((link) => turned(this.frames[link.body], link.x || 0, link.y || 0)));
      const clear = gap * unit + Math.abs(dx) * (half - 2) + Math.abs(dy) * size / 3;
      [x, y] = [x + dx * clear, y + dy * clear];
    }
    return { text, size, free, color: label.rim ? this.rim(label.color) : this.color(label.color), box: [x, y, half, tall] };
  }

  // Paint texts whose boxes push each other apart; a text fades as it is displaced too far.
  texts(texts, boxes, pins, size) {
    const wanted = boxes.map((box) => [...box]);
    apart(boxes, pins, size);
    texts.forEach(({ text, size, color }, i) => {
      const [x, y, w, h] = boxes[i], far = Math.max(Math.abs(x - wanted[i][0]) / w, Math.abs(y - wanted[i][1]) / h);
      this.pen.globalAlpha = Math.max(0, Math.min(1, 2 * (PUSHED - far)));
      if (far < PUSHED) this.text(text, x, y, size, color);
    });
    this.pen.globalAlpha = 1;
  }
}

function turned({ angle }, x, y) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return [c * x - s * y, s * x + c * y];
}

// Return a point of a body in metres.
function spot(frames, { body, x = 0, y = 0 }) {
  const frame = frames[body], [dx, dy] = turned(frame, x, y);
  return [frame.x + dx, frame.y + dy];
}

// Return the middle direction of the widest gap between some directions, as plane.py (`_free`).
function widest(taken) {
  const turn = 2 * Math.PI;
  const angles = taken.filter(([x, y]) => x || y).map(([x, y]) => (Math.atan2(y, x) + 1e-6 + turn) % turn).sort((a, b) => a - b);
  if (!angles.length) return [0, 1];
  let most = 0, middle = 0;
  angles.forEach((start, i) => {
    const end = i + 1 < angles.length ? angles[i + 1] : angles[0] + turn;
    if (end - start > most + 1e-3) [most, middle] = [end - start, (start + end) / 2];
  });
  return [Math.cos(middle), Math.sin(middle)];
}

// Move boxes [x, y, half width, half height] so that they are inside the picture and cover neither each other nor pins
// [x, y, radius], as surface.py (`placed`).
function apart(boxes, pins, size) {
  for (let pass = 0; pass < 60; pass++) {
    let moved = false;
    boxes.forEach((box, i) => {
      for (const other of boxes.slice(i + 1)) {
        const over = box[2] + other[2] - Math.abs(box[0] - other[0]);
        const under = box[3] + other[3] - Math.abs(box[1] - other[1]);
        if (over <= 0 || under <= 0) continue;
        const k = over < under ? 0 : 1, way = Math.min(over, under) / 2 + 0.01;
        const sign = box[k] - other[k] >= 0 ? 1 : -1;
        box[k] += sign * way;
        other[k] -= sign * way;
        moved = true;
      }
      for (const [x, y, r] of pins) {
        const over = box[2] + r - Math.abs(box[0] - x), under = box[3] + r - Math.abs(box[1] - y);
        if (over <= 0 || under <= 0) continue;
        const k = over < under ? 0 : 1, way = Math.min(over, under) + 0.01;
        box[k] += box[k] >= [x, y][k] ? way : -way;
        moved = true;
      }
      for (const k of [0, 1]) box[k] = Math.min(Math.max(box[k], box[2 + k]), Math.max(size[k] - box[2 + k], box[2 + k]));
    });
    if (!moved) break;
  }
  return boxes;
}

// Return the corners of the convex hull; both ends if all points are on one line.
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
