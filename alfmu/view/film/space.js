// The film of a mechanism in space, on the stage of shared/space.js.
const { frames, unit, extent } = film;
const shows = Object.fromEntries([...document.querySelectorAll("#shows input")].map((box) => [box.name, box]));
const stage = new Stage(canvas, document.getElementById("names"), film, film.palette, () => { if (!playing) draw(); });

function poseAt(name, i, j, share) {
  const { p, e } = frames[name], at = (q) => q[i] + share * (q[j] - q[i]);
  const [turn, next] = [i, j].map((k) => new THREE.Quaternion(e[1][k], e[2][k], e[3][k], e[0][k]).normalize());
  return { place: vector(p.map(at)), turn: turn.slerp(next, share) };
}

const posesAt = (...when) => Object.fromEntries(Object.keys(frames).map((name) => [name, poseAt(name, ...when)]));

// Draw the trails of points up to the present time.
function trail({ at, color }) {
  const points = time.map((_, i) => {
    stage.frames = { [at.frame]: poseAt(at.frame, i, i, 0) };
    return stage.place(at);
  });
  const material = new THREE.LineBasicMaterial({ color: stage.painter.color(color) });
  const line = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), material);
  line.frustumCulled = false;
  stage.world.add(line);
  return line;
}

// Draw forces and moments as arrows, scaled by the largest of their kind.
function arm(arrow) {
  const group = new THREE.Group(), material = new THREE.MeshBasicMaterial({ color: film.colors[arrow.kind][arrow.role] });
  const rod = along(new THREE.CylinderGeometry(0.45 * unit, 0.45 * unit, 1, 12)).translate(0, 0, 0.5);
  const tip = along(new THREE.ConeGeometry(1.3 * unit, 3 * unit, 20));
  const shaft = new THREE.Mesh(rod, material), count = arrow.kind === "moment" ? 2 : 1;
  const heads = Array.from({ length: count }, () => new THREE.Mesh(tip, material));
  group.add(shaft, ...heads);
  stage.world.add(group);
  return { arrow, group, shaft, heads };
}

function aim({ arrow, group, shaft, heads }, i, j, share) {
  const values = arrow.values.map((x) => x[i] + share * (x[j] - x[i]));
  const effort = arrow.along
    ? vector(arrow.along).normalize().applyQuaternion(stage.frames[arrow.at.frame].turn).multiplyScalar(values[0])
    : vector(values);
  // At a pole the force is infinite: draw its head alone, with a gap in place of the shaft.
  const pole = arrow.role === "reaction" && film.poles.includes(share < 0.5 ? i : j);
  const length = pole ? 0.36 * extent : 0.3 * extent * effort.length() / film.most[arrow.kind];
  shaft.visible = !pole;
  group.visible = shows[arrow.kind + "s"].checked && length > 1.5 * unit;
  if (!group.visible) return;
  group.position.copy(stage.place(arrow.at));
  group.quaternion.setFromUnitVectors(Z, effort.normalize());
  shaft.scale.z = Math.max(length - 1.5 * unit, 1e-9);
  heads.forEach((head, n) => head.position.setZ(length - (1.5 + 2.2 * n) * unit));
}

// Called by the clock.

function resized() { stage.resize(canvas.clientWidth, canvas.clientWidth * height / width, film.size); }

function draw() {
  const [i, j, share] = around(now);
  stage.pose(posesAt(i, j, share));
  trails.forEach((line) => {
    line.visible = shows.trails.checked;
    line.geometry.setDrawRange(0, i + 1);
  });
  arrows.forEach((arrow) => aim(arrow, i, j, share));
  stage.show(shows.names.checked);
  showTime();
}

stage.build(posesAt(0, 0, 0));
const trails = film.trails.map(trail), arrows = film.arrows.map(arm);
resized();
Object.values(shows).forEach((box) => box.addEventListener("change", draw));
canvas.addEventListener("dblclick", () => { stage.home(); draw(); });

