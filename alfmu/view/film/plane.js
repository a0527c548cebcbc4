// The picture of a mechanism in the plane.
const { scene, dots, poses } = film, pen = canvas.getContext("2d");

// Place and angle of every frame at t, interpolated.
function posesAt(t) {
  const [i, j, share] = around(t), frames = {};
  for (const name in poses) {
    const [x, y, angle] = poses[name].map((q) => q[i] + share * (q[j] - q[i]));
    frames[name] = { x, y, angle };
  }
  return [frames, i];
}

const pixels = (x, y) => [scene.origin[0] + scene.scale * x, scene.origin[1] + scene.scale * y];

function turned(pose, x, y) {
  const c = Math.cos(pose.angle), s = Math.sin(pose.angle);
  return [c * x - s * y, s * x + c * y];
}

function place(frames, at) {
  const pose = frames[at.body], [dx, dy] = turned(pose, at.x, at.y);
  return pixels(pose.x + dx, pose.y + dy);
}

function stroke(points, { width, color, filled }) {
  pen.lineWidth = width;
  pen.strokeStyle = pen.fillStyle = color;
  pen.beginPath();
  if (points.length === 1) {
    pen.arc(...points[0], width / 2, 0, 2 * Math.PI);
    pen.fill();
    return;
  }
  points.forEach(([x, y]) => pen.lineTo(x, y));
  if (filled) { pen.closePath(); pen.fill(); }
  pen.stroke();
}

function part(frames, { at, strokes, angle }) {
  const [[ox, oy], end] = at.map((a) => place(frames, a));
  const turn = angle + frames[at[0].body].angle;
  let ax = Math.cos(turn), ay = Math.sin(turn), across = 1;
  if (end) {
    [ax, ay] = [end[0] - ox, end[1] - oy];
    across = 1 / (Math.hypot(ax, ay) || 1);
  }
  for (const s of strokes) {
    stroke(s.points.map(([x, y]) => [ox + x * ax - y * across * ay, oy + x * ay + y * across * ax]), s);
  }
}

function trail(dot, frames, i) {
  const [xs, ys] = poses[dot], points = [];
  for (let k = 0; k <= i; k++) points.push(pixels(xs[k], ys[k]));
  points.push(pixels(frames[dot].x, frames[dot].y));
  stroke(points, { width: 2.5 * scene.unit, color: scene.colors[dot] });
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

// Where a label would stand, and half its size.
function label(frames, { text, at, links, gap, size }) {
  const places = at.map((a) => place(frames, a));
  let [x, y] = [0, 1].map((k) => places.reduce((sum, p) => sum + p[k], 0) / places.length);
  pen.font = `${size}px {{fonts}}`;
  const half = pen.measureText(text).width / 2;
  if (gap) {
    const [dx, dy] = free(links.map((link) => turned(frames[link.body], link.x, link.y)));
    const clear = gap + Math.abs(dx) * half + Math.abs(dy) * size / 3;
    [x, y] = [x + dx * clear, y + dy * clear];
  }
  return [x, y, half + 2, 0.55 * size + 1];
}

function labels(frames) {
  const fixed = scene.labels.filter((l) => !l.free), free = scene.labels.filter((l) => l.free);
  const pins = scene.pins.map((at) => [...place(frames, at), scene.pin]);
  const boxes = [...fixed.map((l) => label(frames, l)), ...apart(free.map((l) => label(frames, l)), pins, film.size)];
  [...fixed, ...free].forEach((l, i) => lettered(pen, l.text, boxes[i][0], boxes[i][1], l.size, l.color));
}

function resized() {
  canvas.width = Math.round(canvas.clientWidth * devicePixelRatio);
  canvas.height = Math.round(canvas.width * height / width);
}

function draw() {
  const [frames, i] = posesAt(now), k = canvas.width / width;
  pen.setTransform(k, 0, 0, -k, 0, k * height);
  pen.fillStyle = "{{background}}";
  pen.fillRect(0, 0, width, height);
  pen.lineCap = pen.lineJoin = "round";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  scene.back.forEach((p) => part(frames, p));
  dots.forEach((dot) => trail(dot, frames, i));
  scene.front.forEach((p) => part(frames, p));
  labels(frames);
  showTime();
}

