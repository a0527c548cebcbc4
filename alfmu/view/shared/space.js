// Pictures in space for films and live pages: a stage with pieces (`Piece` of pieces.py) on a floor, a view turned by the
// mouse, and names on a canvas above it. scripts/vendor_three.py bundles THREE. Frames are {place, turn} by name.
const vector = (x) => new THREE.Vector3(...x), Z = vector([0, 0, 1]);

const point = ({ x = 0, y = 0, z = 0 }) => vector([x, y, z]);

const along = (shape) => shape.rotateX(Math.PI / 2);

const discard = (of) => of.traverse(({ geometry, material }) => [geometry, material].forEach((x) => x && x.dispose()));

class Stage {
  // `about` is the result of `stage_of` in pages.py, `palette` has the colours of a Painter; `changed` is called after a turn.
  constructor(canvas, overlay, about, palette, changed) {
    Object.assign(this, { canvas, overlay, about, extent: about.extent, up: vector(about.up) });
    this.painter = new Painter(overlay.getContext("2d"), palette);
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.camera = new THREE.PerspectiveCamera(about.camera.opening);
    this.camera.up.copy(this.up);
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.home();
    this.controls.addEventListener("change", changed);
  }

  home() {
    this.camera.position.copy(vector(this.about.camera.eye));
    this.controls.target.copy(vector(this.about.camera.target));
    this.reaches();
  }

  // Set the smallest and the largest distance of the camera.
  reaches() {
    Object.assign(this.controls, { minDistance: 0.2 * this.extent, maxDistance: 12 * this.extent });
    Object.assign(this.camera, { near: 0.01 * this.extent, far: 40 * this.extent });
    this.camera.updateProjectionMatrix();
    this.controls.update();
  }

  // Set the size of the picture on the page, and that in which names are measured [pixels].
  resize(across, tall, size = [across, tall]) {
    this.size = size;
    this.camera.aspect = across / tall;
    this.camera.updateProjectionMatrix();
    this.renderer.setPixelRatio(devicePixelRatio);
    this.renderer.setSize(across, tall, false);
    this.overlay.width = Math.round(across * devicePixelRatio);
    this.overlay.height = Math.round(tall * devicePixelRatio);
    this.overlay.style.width = across + "px";
    this.overlay.style.height = tall + "px";
  }

  place(at) {
    const frame = this.frames[at.frame];
    return point(at).applyQuaternion(frame.turn).add(frame.place);
  }

  // Build the stage for given frames: pieces, floor and light, in the colours of the palette.
  build(frames) {
    this.frames = frames;
    this.renderer.setClearColor(this.painter.palette.paper);
    if (this.world) discard(this.world);
    this.world = new THREE.Scene();
    this.painted = new Map();
    this.moving = this.about.pieces.map((piece) => {
      const two = piece.at.length === 2 && piece.kind !== "plate", [first, second] = piece.at;
      const length = (two && this.place(second).sub(this.place(first)).length()) || this.extent;
      const mesh = new THREE.Mesh(shaped(piece, length), this.paint(piece.color)[0]);
      mesh.castShadow = true;
      if (piece.kind !== "coil") mesh.add(new THREE.Mesh(mesh.geometry, this.paint(piece.color)[1]));
      this.world.add(mesh);
      const turn = new THREE.Quaternion().setFromUnitVectors(Z, vector(piece.axis).normalize());
      return { piece, mesh, two, turn: piece.kind === "plate" ? turn.identity() : turn };
    });
    this.lay();
    this.light();
  }

  // Return the material of a colour, and that of its rim.
  paint(color) {
    if (!this.painted.has(color)) {
      const rim = new THREE.MeshBasicMaterial({ color: this.painter.rim(color), side: THREE.BackSide });
      rim.onBeforeCompile = (shader) => {
        shader.vertexShader = shader.vertexShader.replace("#include <begin_vertex>",
          `vec3 transformed = position + normalize(normal) * ${(0.0026 * this.about.extent).toExponential(4)};`);
      };
      const plain = new THREE.MeshLambertMaterial({ color: this.painter.color(color), side: THREE.DoubleSide });
      this.painted.set(color, [plain, rim]);
    }
    return this.painted.get(color);
  }

  // Build the floor: a grid, and a plane for shadows.
  lay() {
    const { east, north, low, high, cell, height } = this.about.floor, lines = [[], []], { up, extent } = this;
    const corner = (x, y) => vector(east).multiplyScalar(x * cell).addScaledVector(vector(north), y * cell)
      .addScaledVector(up, height);
    for (const k of [0, 1]) {
      for (let i = low[k]; i <= high[k]; i++) {
        const ends = k ? [corner(low[0], i), corner(high[0], i)] : [corner(i, low[1]), corner(i, high[1])];
        lines[i ? 0 : 1].push(...ends);
      }
    }
    if (this.ground) discard(this.ground.removeFromParent());
    this.ground = new THREE.Group();
    lines.forEach((points, i) => {
      const color = this.painter.color(i ? "zero" : "grid");
      this.ground.add(new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(points),
        new THREE.LineBasicMaterial({ color })));
    });
    const plane = new THREE.Mesh(new THREE.PlaneGeometry(12 * extent, 12 * extent), new THREE.ShadowMaterial({ opacity: 0.13 }));
    plane.position.copy(corner((low[0] + high[0]) / 2, (low[1] + high[1]) / 2)).addScaledVector(up, -0.001 * extent);
    plane.quaternion.setFromUnitVectors(Z, up);
    plane.receiveShadow = true;
    this.ground.add(plane);
    this.world.add(this.ground);
  }

  light() {
    const sun = new THREE.DirectionalLight("#ffffff", 2.1), { extent, up } = this, reach = 1.3 * extent;
    const target = vector(this.about.camera.target);
    sun.position.copy(target).addScaledVector(up, 3 * extent)
      .addScaledVector(vector(this.about.camera.eye).sub(target).normalize(), 1.2 * extent)
      .addScaledVector(vector(this.about.floor.east), -0.4 * extent);
    sun.target.position.copy(target);
    sun.castShadow = true;
    sun.shadow.mapSize.set(1024, 1024);
    sun.shadow.radius = 2;
    Object.assign(sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, far: 9 * extent });
    this.world.add(new THREE.AmbientLight("#ffffff", 1.35), sun, sun.target);
  }

  pose(frames) {
    this.frames = frames;
    for (const { piece, mesh, two, turn } of this.moving) {
      mesh.position.copy(this.place(piece.at[0]));
      if (two) {
        const way = this.place(piece.at[1]).sub(mesh.position);
        mesh.scale.z = way.length() || 1e-9;
        mesh.quaternion.setFromUnitVectors(Z, way.normalize());
      } else {
        mesh.quaternion.copy(frames[piece.at[0].frame].turn).multiply(turn);
      }
    }
  }

  // Paint the view of the camera, the directions of the axes, and names if requested.
  show(named) {
    const { pen } = this.painter, [width, height] = this.size, k = this.overlay.width / width;
    this.renderer.render(this.world, this.camera);
    pen.setTransform(k, 0, 0, -k, 0, k * height);
    pen.clearRect(0, 0, width, height);
    this.axes();
    if (named) this.names();
  }

  pixels(place) {
    const { x, y, z } = place.clone().project(this.camera), [width, height] = this.size;
    return [(x + 1) / 2 * width, (y + 1) / 2 * height, z < 1];
  }

  names() {
    const { about, painter } = this, found = new Map();
    const scale = this.size[1] / 2 / Math.tan(about.camera.opening * Math.PI / 360);
    for (const { text, at, joint, color, size } of about.labels) {
      const middle = at.map((a) => this.place(a)).reduce((sum, p) => sum.add(p), vector([0, 0, 0])).divideScalar(at.length);
      const away = scale / this.camera.position.distanceTo(middle);
      const [x, y, front] = this.pixels(middle), key = joint ? `${Math.round(x)},${Math.round(y)}` : text;
      if (!front) continue;
      const same = found.get(key);
      if (same) same.text += ", " + text;
      else {
        const [dx, dy] = joint ? [0, 9 + 2.6 * about.unit * away] : [12, 10];
        const shown = joint ? painter.color(color) : painter.rim(color);
        found.set(key, { text, color: shown, size, joint, x: x + dx, y: y + dy, pin: [x, y, 1.4 * about.unit * away] });
      }
    }
    const all = [...found.values()], boxes = all.map(({ text, x, y, size }) => [x, y, ...painter.box(text, size)]);
    painter.texts(all, boxes, all.filter((l) => l.joint).map((l) => l.pin), this.size);
  }

  axes() {
    const turn = this.camera.quaternion.clone().invert(), color = this.painter.color("faint");
    for (const [name, axis] of [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]]) {
      const { x, y } = vector(axis).applyQuaternion(turn);
      if (Math.hypot(x, y) < 0.45) continue; // this axis points at the eye
      this.painter.line([[44, 44], [44 + 28 * x, 44 + 28 * y]], 1.5, color);
      this.painter.text(name, 44 + 39 * x, 44 + 39 * y, 12, color);
    }
  }
}

// Return the shape of a piece about its first point; z is along its axis, or from 0 to 1 between its points.
function shaped({ kind, size, at }, length) {
  if (kind === "ball") return new THREE.SphereGeometry(size[0], 32, 20);
  if (kind === "box") return new THREE.BoxGeometry(2 * size[0], 2 * size[1], 2 * size[2]);
  if (kind === "cylinder") return along(new THREE.CylinderGeometry(size[0], size[0], 2 * size[1], 32));
  if (kind === "cone") return along(new THREE.CylinderGeometry(size[1], size[0], size[2], 32)).translate(0, 0, -size[2] / 2);
  if (kind === "coil") return helix(size[0], size[1], length);
  if (kind === "plate") return plate(at.map(point), size[0]);
  const share = size[2] - size[1];
  return along(new THREE.CylinderGeometry(size[0], size[0], share, 24)).translate(0, 0, size[1] + share / 2);
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

function plate(corners, half) {
  const from = corners[0], edges = corners.map((c) => c.clone().sub(from)), across = vector([0, 0, 0]);
  edges.slice(1).forEach((edge, i) => across.add(edges[i].clone().cross(edge)));
  const turn = new THREE.Quaternion().setFromUnitVectors(Z, across.normalize()), back = turn.clone().invert();
  const flat = edges.map((edge) => edge.clone().applyQuaternion(back)).map(({ x, y }) => new THREE.Vector2(x, y));
  const solid = new THREE.ExtrudeGeometry(new THREE.Shape(flat), { depth: 2 * half, bevelEnabled: false });
  return solid.translate(0, 0, -half).applyQuaternion(turn);
}

