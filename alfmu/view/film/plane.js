// The picture of a mechanism in the plane: the scene that plane.py made, by the painter of shared/strokes.js.
const { scene, dots, poses } = film, painter = new Painter(canvas.getContext("2d"), "{{background}}");

// Place and angle of every frame at t, interpolated.
function posesAt(t) {
  const [i, j, share] = around(t), frames = {};
  for (const name in poses) {
    const [x, y, angle] = poses[name].map((q) => q[i] + share * (q[j] - q[i]));
    frames[name] = { x, y, angle };
  }
  return [frames, i];
}

function trail(dot, frames, i) {
  const [xs, ys] = poses[dot], points = [];
  const pixels = (x, y) => [scene.origin[0] + scene.scale * x, scene.origin[1] + scene.scale * y];
  for (let k = 0; k <= i; k++) points.push(pixels(xs[k], ys[k]));
  points.push(pixels(frames[dot].x, frames[dot].y));
  painter.line(points, 2.5 * scene.unit, scene.colors[dot]);
}

function resized() {
  canvas.width = Math.round(canvas.clientWidth * devicePixelRatio);
  canvas.height = Math.round(canvas.width * height / width);
}

function draw() {
  const [frames, i] = posesAt(now), k = canvas.width / width, { pen, paper } = painter;
  pen.setTransform(k, 0, 0, -k, 0, k * height);
  pen.fillStyle = paper;
  pen.fillRect(0, 0, width, height);
  painter.paint(scene, frames, () => dots.forEach((dot) => trail(dot, frames, i)));
  showTime();
}

