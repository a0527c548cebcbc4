// What films and live pages share: a painter on a canvas, and labels that keep apart. It paints scenes of the plane as
// `paint` of plane.py does (`plane.Scene`): strokes in pixels that move with frames {x, y [m], angle [rad]} by name.

const PUSHED = 2.5; // half sizes of a label that others may push it away: the rule of surface.py

class Painter {
  constructor(pen, paper) {
    this.pen = pen;
    this.paper = paper;
  }

  // A line with round ends; a disc where it has one point, an area where it is filled.
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

  // A text about its middle, or beside a place, with a rim; y points upwards or downwards as the pen has it.
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
    pen.strokeStyle = this.paper;
    pen.strokeText(text, 0, 0);
    pen.fillStyle = color;
    pen.fillText(text, 0, 0);
    pen.restore();
  }

  font(size) { this.pen.font = `${size}px {{fonts}}`; }

  // Half the size of the box of a text.
  box(text, size) {
    this.font(size);
    return [this.pen.measureText(text).width / 2 + 2, 0.55 * size + 1];
  }

  // A scene while the frames are somewhere; `trails` paints what is between its back and its front. y points upwards.
  paint(scene, frames, trails) {
    scene.back.forEach((each) => this.part(scene, frames, each));
    trails();
    scene.front.forEach((each) => this.part(scene, frames, each));
    const fixed = scene.labels.filter((l) => !l.free), free = scene.labels.filter((l) => l.free);
    const pins = scene.pins.map((at) => [...placed(scene, frames, at), scene.pin]);
    fixed.forEach((l) => this.text(l.text, ...this.label(scene, frames, l).slice(0, 2), l.size, l.color));
    this.texts(free, free.map((l) => this.label(scene, frames, l)), pins, scene.size);
  }

  // Texts in boxes that are pushed apart; one that would stand too far off fades.
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

  part(scene, frames, { at, strokes, angle }) {
    const [start, end] = at.map((a) => placed(scene, frames, a)), turn = angle + frames[at[0].body].angle;
    if (end) this.between(start, end, strokes);
    else this.along(start, [Math.cos(turn), Math.sin(turn)], 1, strokes);
  }

  // Strokes whose x runs from 0 at one point to 1 at another, and whose y is in pixels across.
  between([ax, ay], [bx, by], strokes) {
    const way = [bx - ax, by - ay];
    this.along([ax, ay], way, 1 / (Math.hypot(...way) || 1), strokes);
  }

  along([ox, oy], [ax, ay], across, strokes) {
    for (const { points, width, color, filled } of strokes) {
      const there = points.map(([x, y]) => [ox + x * ax - y * across * ay, oy + x * ay + y * across * ax]);
      this.line(there, width, color, filled);
    }
  }

  // Where a label would stand, and half its size.
  label(scene, frames, { text, at, links, gap, size }) {
    const places = at.map((a) => placed(scene, frames, a)), [half, tall] = this.box(text, size);
    let [x, y] = [0, 1].map((k) => places.reduce((sum, p) => sum + p[k], 0) / places.length);
    if (gap) {
      const [dx, dy] = free(links.map((link) => turned(frames[link.body], link.x, link.y)));
      const clear = gap + Math.abs(dx) * (half - 2) + Math.abs(dy) * size / 3;
      [x, y] = [x + dx * clear, y + dy * clear];
    }
    return [x, y, half, tall];
  }
}

function turned({ angle }, x, y) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return [c * x - s * y, s * x + c * y];
}

// A point of a body {body, x, y [m]} in pixels.
function placed({ origin, scale }, frames, { body, x, y }) {
  const frame = frames[body], [dx, dy] = turned(frame, x, y);
  return [origin[0] + scale * (frame.x + dx), origin[1] + scale * (frame.y + dy)];
}

// The direction in the middle of the widest gap between some directions: the rule of plane.py (`_free`).
function free(taken) {
  if (!taken.length) return [0, 1];
  const turn = 2 * Math.PI;
  const angles = taken.map(([x, y]) => (Math.atan2(y, x) + 1e-6 + turn) % turn).sort((a, b) => a - b);
  let widest = 0, middle = 0;
  angles.forEach((start, i) => {
    const end = i + 1 < angles.length ? angles[i + 1] : angles[0] + turn;
    if (end - start > widest + 1e-3) [widest, middle] = [end - start, (start + end) / 2];
  });
  return [Math.cos(middle), Math.sin(middle)];
}

// Where labels stand that keep off each other, off the pins [x, y, radius] and inside the picture: the rules of
// surface.py (`placed`). A box is [x, y, half its width, half its height]; pins move nothing but labels.
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
