// The picture of a mechanism in the plane: the scene of scene.py, by the painter of shared/strokes.js.
const { scene, fit, dots, poses, palette } = film, painter = new Painter(canvas.getContext("2d"), palette);

// Return the interpolated position and angle of every frame at t.
function posesAt(t) {
  const [i, j, share] = around(t), frames = {};
  for (const name in poses) {
    const [x, y, angle] = poses[name].map((q) => q[i] + share * (q[j] - q[i]));
    frames[name] = { x, y, angle };
  }
  return [frames, i];
}

function trail(dot, i) {
  const [xs, ys] = poses[dot], points = [];
  for (let k = 0; k <= i; k++) points.push(painter.place({ body: "ground", x: xs[k], y: ys[k] }));
  painter.line([...points, painter.place({ body: dot })], 2.5 * fit.unit, scene.colors[dot]);
}

function resized() {
  canvas.width = Math.round(canvas.clientWidth * devicePixelRatio);
  canvas.height = Math.round(canvas.width * height / width);
}

function draw() {
  const [frames, i] = posesAt(now), k = canvas.width / width, { pen } = painter;
  pen.setTransform(k, 0, 0, -k, 0, k * height);
  pen.fillStyle = palette.paper;
  pen.fillRect(0, 0, width, height);
  painter.paint(scene, fit, frames, () => dots.forEach((dot) => trail(dot, i)));
  showTime();
}

