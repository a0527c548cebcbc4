// The picture of a mechanism in space: pieces with extent on a floor, in a view that the mouse turns. The pieces are those
// of space.py; THREE is what scripts/vendor_three.py bundles.
const { pieces, frames, camera: seen, unit, extent } = film;
const overlay = document.getElementById("names"), pen = overlay.getContext("2d");
const painter = new Painter(pen, "{{background}}");
const shows = Object.fromEntries([...document.querySelectorAll("#shows input")].map((box) => [box.name, box]));
const vector = (x) => new THREE.Vector3(...x), up = vector(film.up), Z = vector([0, 0, 1]);

const renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
renderer.setClearColor("{{background}}");
renderer.shadowMap.enabled = true;
renderer.shadowMap.type = THREE.PCFShadowMap;
const world = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(seen.opening, width / height, 0.01 * extent, 40 * extent);
camera.up.copy(up);
const controls = new THREE.OrbitControls(camera, canvas);
controls.enableDamping = false;
controls.minDistance = 0.2 * extent;
controls.maxDistance = 12 * extent;
controls.addEventListener("change", () => { if (!playing) draw(); });

// Frames and points at a time.

let posed = {};

function pose(name, i, j, share) {
  const frame = frames[name], at = (q) => q[i] + share * (q[j] - q[i]);
  const turn = new THREE.Quaternion(frame.e[1][i], frame.e[2][i], frame.e[3][i], frame.e[0][i]);
  const next = new THREE.Quaternion(frame.e[1][j], frame.e[2][j], frame.e[3][j], frame.e[0][j]);
  return { place: vector(frame.p.map(at)), turn: turn.normalize().slerp(next.normalize(), share) };
}

function place(at) {
  const frame = posed[at.frame];
  return vector([at.x, at.y, at.z]).applyQuaternion(frame.turn).add(frame.place);
}

// Materials and shapes.

const outline = new Map(), surface = new Map();

function painted(color) {
  if (!surface.has(color)) {
    surface.set(color, new THREE.MeshLambertMaterial({ color, side: THREE.DoubleSide }));
    const rim = new THREE.MeshBasicMaterial({ color: film.rims[color], side: THREE.BackSide });
    rim.onBeforeCompile = (shader) => {
      shader.vertexShader = shader.vertexShader.replace("#include <begin_vertex>",
        `vec3 transformed = position + normalize(normal) * ${(0.0026 * extent).toExponential(4)};`);
    };
    outline.set(color, rim);
  }
  return surface.get(color);
}

function along(shape) {
  return shape.rotateX(Math.PI / 2);
}

function helix(radius, wire, length) {
  const points = [vector([0, 0, 0]), vector([0, 0, 0.16 * length])];
  for (let i = 0; i <= 9 * 16; i++) {
    const angle = 2 * Math.PI * i / 16;
    points.push(vector([radius * Math.cos(angle), radius * Math.sin(angle), (0.18 + 0.64 * i / 144) * length]));
  }
  points.push(vector([0, 0, 0.84 * length]), vector([0, 0, length]));
  return new THREE.TubeGeometry(new THREE.CatmullRomCurve3(points), 500, wire, 6).scale(1, 1, 1 / length);
}

function shaped({ kind, size, outline: corners }, length) {
  if (kind === "ball") return new THREE.SphereGeometry(size[0], 32, 20);
  if (kind === "box") return new THREE.BoxGeometry(2 * size[0], 2 * size[1], 2 * size[2]);
  if (kind === "cylinder") return along(new THREE.CylinderGeometry(size[0], size[0], 2 * size[1], 32));
  if (kind === "cone") return along(new THREE.CylinderGeometry(size[1], size[0], size[2], 32)).translate(0, 0, -size[2] / 2);
  if (kind === "coil") return helix(size[0], size[1], length);
  if (kind === "rod") {
    const share = size[2] - size[1];
    return along(new THREE.CylinderGeometry(size[0], size[0], share, 24)).translate(0, 0, size[1] + share / 2);
  }
  const shape = new THREE.Shape(corners.map(([x, y]) => new THREE.Vector2(x, y)));
  return new THREE.ExtrudeGeometry(shape, { depth: 2 * size[0], bevelEnabled: false }).translate(0, 0, -size[0]);
}

const moving = [];

function build() {
  for (const piece of pieces) {
    const two = piece.at.length === 2, length = two ? place(piece.at[1]).sub(place(piece.at[0])).length() || extent : 1;
    const mesh = new THREE.Mesh(shaped(piece, length), painted(piece.color));
    mesh.castShadow = true;
    if (piece.kind !== "coil") mesh.add(new THREE.Mesh(mesh.geometry, outline.get(piece.color)));
    world.add(mesh);
    const [w, x, y, z] = piece.turn;
    moving.push({ piece, mesh, two, turn: new THREE.Quaternion(x, y, z, w) });
  }
}

function pose_pieces() {
  for (const { piece, mesh, two, turn } of moving) {
    mesh.position.copy(place(piece.at[0]));
    if (two) {
      const way = place(piece.at[1]).sub(mesh.position);
      mesh.scale.z = way.length() || 1e-9;
      mesh.quaternion.setFromUnitVectors(Z, way.normalize());
    } else {
      mesh.quaternion.copy(posed[piece.at[0].frame].turn).multiply(turn);
    }
  }
}

// The floor: a grid, and the shadows on it.

function floor() {
  const { east, north, low, high, cell, height: level } = film.floor, lines = [[], []];
  const corner = (x, y) => vector(east).multiplyScalar(x * cell).addScaledVector(vector(north), y * cell)
    .addScaledVector(up, level);
  for (const k of [0, 1]) {
    for (let i = low[k]; i <= high[k]; i++) {
      const ends = k ? [corner(low[0], i), corner(high[0], i)] : [corner(i, low[1]), corner(i, high[1])];
      lines[i ? 0 : 1].push(...ends);
    }
  }
  lines.forEach((points, i) => {
    const color = i ? film.colors.zero : film.colors.grid;
    world.add(new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(points),
      new THREE.LineBasicMaterial({ color })));
  });
  const plane = new THREE.Mesh(new THREE.PlaneGeometry(12 * extent, 12 * extent),
    new THREE.ShadowMaterial({ opacity: 0.13 }));
  plane.position.copy(corner((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)).addScaledVector(up, -0.001 * extent);
  plane.quaternion.setFromUnitVectors(Z, up);
  plane.receiveShadow = true;
  world.add(plane, new THREE.AmbientLight("#ffffff", 1.35));
  const sun = new THREE.DirectionalLight("#ffffff", 2.1), reach = 1.3 * extent;
  const target = vector(seen.target);
  sun.position.copy(target).addScaledVector(up, 3 * extent)
    .addScaledVector(vector(seen.eye).sub(target).normalize(), 1.2 * extent).addScaledVector(vector(east), -0.4 * extent);
  sun.target.position.copy(target);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  sun.shadow.radius = 2;
  Object.assign(sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, far: 9 * extent });
  world.add(sun, sun.target);
}

// Trails of points, as far as the film is.

const trails = [];

function trail() {
  for (const { at, color } of film.trails) {
    const points = time.map((_, i) => {
      posed = { [at.frame]: pose(at.frame, i, i, 0) };
      return place(at);
    });
    const shape = new THREE.BufferGeometry().setFromPoints(points);
    const line = new THREE.Line(shape, new THREE.LineBasicMaterial({ color }));
    line.frustumCulled = false;
    trails.push(line);
    world.add(line);
  }
}

// Forces and moments: arrows as long as the largest of their kind allows.

const arrows = [];

function arm() {
  for (const arrow of film.arrows) {
    const group = new THREE.Group(), color = film.colors[arrow.kind][arrow.role];
    const material = new THREE.MeshBasicMaterial({ color });
    const shaft = along(new THREE.CylinderGeometry(0.45 * unit, 0.45 * unit, 1, 12)).translate(0, 0, 0.5);
    const head = along(new THREE.ConeGeometry(1.3 * unit, 3 * unit, 20));
    const parts = { shaft: new THREE.Mesh(shaft, material), heads: [new THREE.Mesh(head, material)] };
    if (arrow.kind === "moment") parts.heads.push(new THREE.Mesh(head, material));
    group.add(parts.shaft, ...parts.heads);
    world.add(group);
    arrows.push({ arrow, group, ...parts });
  }
}

function aim(i, j, share) {
  for (const { arrow, group, shaft, heads } of arrows) {
    const values = arrow.values.map((x) => x[i] + share * (x[j] - x[i]));
    const effort = arrow.along
      ? vector(arrow.along).normalize().applyQuaternion(posed[arrow.at.frame].turn).multiplyScalar(values[0])
      : vector(values);
    const size = effort.length(), most = film.most[arrow.kind];
    const length = 0.3 * extent * size / most;
    group.visible = shows[arrow.kind + "s"].checked && length > 1.5 * unit;
    if (!group.visible) continue;
    group.position.copy(place(arrow.at));
    group.quaternion.setFromUnitVectors(Z, effort.normalize());
    shaft.scale.z = Math.max(length - 1.5 * unit, 1e-9);
    heads.forEach((head, n) => head.position.setZ(length - (1.5 + 2.2 * n) * unit));
  }
}

// Names, on a canvas above the picture.

const clear = new THREE.Vector3();

function pixels(point) {
  clear.copy(point).project(camera);
  return [(clear.x + 1) / 2 * width, (clear.y + 1) / 2 * height, clear.z < 1];
}

function names() {
  const k = overlay.width / width, scale = height / 2 / Math.tan(seen.opening * Math.PI / 360);
  pen.setTransform(k, 0, 0, -k, 0, k * height);
  pen.clearRect(0, 0, width, height);
  axes();
  if (!shows.names.checked) return;
  const found = new Map();
  for (const { text, at, joint, color, size } of film.labels) {
    const point = at.map(place).reduce((sum, p) => sum.add(p), new THREE.Vector3()).divideScalar(at.length);
    const away = scale / camera.position.distanceTo(point);
    const [x, y, front] = pixels(point), key = joint ? `${Math.round(x)},${Math.round(y)}` : text;
    if (!front) continue;
    const same = found.get(key);
    if (same) same.text += ", " + text;
    else found.set(key, { text, color, size, joint, x: x + (joint ? 0 : 12), y: y + (joint ? 9 + 2.6 * unit * away : 10),
      pin: [x, y, 1.4 * unit * away] });
  }
  const all = [...found.values()];
  const boxes = all.map(({ text, x, y, size }) => [x, y, ...painter.box(text, size)]);
  painter.texts(all, boxes, all.filter((l) => l.joint).map((l) => l.pin), film.size);
}

function axes() {
  const turn = camera.quaternion.clone().invert();
  for (const [name, axis] of [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]]) {
    const { x, y } = vector(axis).applyQuaternion(turn);
    if (Math.hypot(x, y) < 0.45) continue; // it points at the eye
    painter.line([[44, 44], [44 + 28 * x, 44 + 28 * y]], 1.5, film.colors.faint);
    painter.text(name, 44 + 39 * x, 44 + 39 * y, 12, film.colors.faint);
  }
}

// What the clock calls.

function resized() {
  const across = canvas.clientWidth;
  renderer.setPixelRatio(devicePixelRatio);
  renderer.setSize(across, across * height / width, false);
  overlay.width = Math.round(across * devicePixelRatio);
  overlay.height = Math.round(overlay.width * height / width);
  overlay.style.width = across + "px";
  overlay.style.height = across * height / width + "px";
}

function draw() {
  const [i, j, share] = around(now);
  posed = Object.fromEntries(Object.keys(frames).map((name) => [name, pose(name, i, j, share)]));
  if (!moving.length) build();
  pose_pieces();
  trails.forEach((line) => {
    line.visible = shows.trails.checked;
    line.geometry.setDrawRange(0, i + 1);
  });
  aim(i, j, share);
  renderer.render(world, camera);
  names();
  showTime();
}

function home() {
  camera.position.copy(vector(seen.eye));
  controls.target.copy(vector(seen.target));
  controls.update();
}

floor();
trail();
arm();
home();
Object.values(shows).forEach((box) => box.addEventListener("change", draw));
canvas.addEventListener("dblclick", () => { home(); draw(); });
