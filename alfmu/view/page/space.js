// The picture of a live page in space, on the stage of shared/space.js.

class Space extends Picture {
  constructor(canvas, about) {
    super(canvas, about);
    this.overlay = find("over");
    this.ground = { place: vector([0, 0, 0]), turn: new THREE.Quaternion() };
    canvas.addEventListener("dblclick", () => { this.refit(); update(); });
  }

  shape(numbers) {
    const { floor } = this.about;
    this.shown = { ...this.about, pieces: resolved(this.about.pieces, numbers), labels: resolved(this.about.labels, numbers) };
    this.shown.floor = { ...floor, low: [...floor.low], high: [...floor.high] };
    this.stale = true;
  }

  poses(row) {
    const pose = ({ kind, columns }) => {
      const [x, y, z = 0, ...more] = columns.map((c) => row[c]), turn = new THREE.Quaternion();
      if (kind === "plane") return { place: vector([x, y, 0]), turn: turn.setFromAxisAngle(Z, z) };
      if (kind === "axis") turn.setFromUnitVectors(Z, vector(more).normalize());
      if (kind === "body") turn.set(...more.slice(1), more[0]).normalize();
      return { place: vector([x, y, z]), turn };
    };
    const moving = Object.entries(this.about.frames).map(([name, frame]) => [name, pose(frame)]);
    return { ground: this.ground, ...Object.fromEntries(moving) };
  }

  // Return to the view in which the page was opened.
  refit() {
    this.room = this.middle = null;
    this.zoom = 1;
    this.distance = 0;
    if (this.stage) this.stage.home();
  }

  // Extend the vertical cylinder that contains all motion, and the floor, to the points of all pieces.
  widen() {
    const { stage, shown: { floor, pieces, unit } } = this, flat = [floor.east, floor.north].map(vector);
    const old = this.room, room = { ...(old || this.about.room) };
    for (const p of pieces.flatMap(({ at }) => at.map((a) => stage.place(a)))) {
      const away = Math.hypot(...flat.map((axis, k) => axis.dot(p) - room.middle[k])), tall = stage.up.dot(p);
      if (!Number.isFinite(away + tall)) continue;
      room.reach = Math.max(room.reach, away);
      [room.low, room.high] = [Math.min(room.low, tall - 5.5 * unit), Math.max(room.high, tall)];
    }
    if (old && ["reach", "low", "high"].every((key) => Math.abs(room[key] - old[key]) < 1e-2 * this.about.extent)) return;
    this.room = room;
    floor.height = room.low;
    for (const k of [0, 1]) {
      const cells = [-1.1, 1.1].map((s) => (room.middle[k] + s * room.reach) / floor.cell);
      floor.low[k] = Math.min(floor.low[k], Math.floor(cells[0]));
      floor.high[k] = Math.max(floor.high[k], Math.ceil(cells[1]));
    }
    stage.extent = Math.max(this.about.extent, Math.hypot(2 * room.reach, room.high - room.low) / 1.5);
    const middle = stage.up.clone().multiplyScalar((room.low + room.high) / 2);
    flat.forEach((axis, k) => middle.addScaledVector(axis, room.middle[k]));
    const shift = middle.clone().sub(this.middle || stage.controls.target);
    this.middle = middle;
    stage.controls.target.add(shift);
    stage.camera.position.add(shift);
    stage.lay();
  }

  // Move the camera to the least distance at which it sees the whole cylinder, times the zoom of the mouse.
  follow() {
    const { camera, controls } = this.stage, way = camera.position.clone().sub(controls.target), length = way.length();
    if (this.distance) this.zoom *= this.distance / length;
    way.divideScalar(length);
    const right = camera.up.clone().cross(way).normalize(), above = way.clone().cross(right), { low, high, reach } = this.room;
    const flat = [this.shown.floor.east, this.shown.floor.north].map(vector), margin = 64 / this.height;
    const slope = Math.tan(camera.fov * Math.PI / 360), slopes = [slope * camera.aspect - slope * margin, slope * (1 - margin)];
    let wanted = 0;
    for (let i = 0; i < 48; i++) {
      const p = camera.up.clone().multiplyScalar((i % 2 ? 1 : -1) * (high - low) / 2);
      flat.forEach((axis, k) => p.addScaledVector(axis, reach * (k ? Math.sin : Math.cos)(i * Math.PI / 24)));
      const off = [right, above].map((axis, k) => Math.abs(axis.dot(p)) / slopes[k]);
      wanted = Math.max(wanted, Math.max(...off) + way.dot(p));
    }
    this.distance = Math.max(wanted, 1e-9) / this.zoom;
    camera.position.copy(controls.target).addScaledVector(way, this.distance);
    this.stage.reaches();
    this.distance = camera.position.distanceTo(controls.target);
  }

  draw(row) {
    const frames = this.poses(row), palette = this.palette();
    if (!this.stage) {
      this.stage = new Stage(this.canvas, this.overlay, this.shown, palette, () => update());
      this.refit();
    }
    const { stage } = this, { painter } = stage;
    if (this.resized()) stage.resize(this.width, this.height);
    stage.frames = frames;
    if (this.stale || painter.palette.paper !== palette.paper) {
      painter.palette = palette;
      stage.about = this.shown;
      stage.build(frames);
      this.lines = this.about.dots.map((name) => {
        const line = new THREE.Line(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ vertexColors: true }));
        line.frustumCulled = false;
        stage.world.add(line);
        return [line, new THREE.Color(this.about.colors[name]), new THREE.Color(palette.paper)];
      });
      this.stale = false;
      this.room = null;
    }
    this.widen();
    this.follow();
    stage.pose(frames);
    this.lines.forEach(([line, color, paper], i) => {
      const points = [...this.trails[i].map(([x, y, z = 0]) => vector([x, y, z])), frames[this.about.dots[i]].place];
      const shades = points.flatMap((_, k) => paper.clone().lerp(color, 0.15 + 0.85 * (k + 1) / points.length).toArray());
      line.geometry.dispose();
      line.geometry = new THREE.BufferGeometry().setFromPoints(points);
      line.geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(shades), 3));
    });
    stage.show(this.names);
    painter.text(`grid ${Number(this.shown.floor.cell.toPrecision(3))} m`, this.width - 12, 14, 12, painter.color("faint"), "right");
  }

  // Turn by angles and zoom by a factor, for the keyboard.
  turn(right, up) {
    const { camera, controls } = this.stage, way = camera.position.clone().sub(controls.target);
    const side = camera.up.clone().cross(way).normalize(), steep = camera.up.angleTo(way) - up;
    if (steep > 0.05 && steep < Math.PI - 0.05) way.applyAxisAngle(side, -up);
    camera.position.copy(controls.target).add(way.applyAxisAngle(camera.up, -right));
  }

  nearer(by) { this.zoom = Math.max(0.3, Math.min(8, this.zoom * by)); }

  hit() { return null; }
}
