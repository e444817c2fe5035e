"use strict";
// The arm and the wound object, or all geoms of a scene, in three dimensions, drawn by three.js.

const PIECES = 6; // of each link, each coloured by whether it is inside the object
const INSIDE = 5e-4; // [m] deeper than this a link is inside
const INSIDE_COLOUR = "#c2187e";

const at = (p) => new THREE.Vector3(...p);

// Where the object's own axes are: columns of its rotation, and its place.
function placeOf(object) {
  const [a, b, c] = object.rotation;
  return new THREE.Matrix4().set(...a, object.position[0], ...b, object.position[1], ...c, object.position[2], 0, 0, 0, 1);
}

// MuJoCo's half-sizes; a cylinder and a capsule lie along z, in three.js along y.
function geometryOf({ shape, size }) {
  if (shape === "box") return new THREE.BoxGeometry(...size.map((half) => 2 * half));
  if (shape === "cylinder") return new THREE.CylinderGeometry(size[0], size[0], 2 * size[1], 64).rotateX(Math.PI / 2);
  if (shape === "capsule") return new THREE.CapsuleGeometry(size[0], 2 * size[1], 24, 48).rotateX(Math.PI / 2);
  const ball = new THREE.SphereGeometry(1, 48, 32);
  return shape === "ellipsoid" ? ball.scale(...size) : ball.scale(size[0], size[0], size[0]);
}

// Distance of a point, in the object's own axes, from its surface; negative inside.
function distanceTo({ shape, size }, p) {
  if (shape === "sphere") return p.length() - size[0];
  if (shape === "capsule") return p.distanceTo(new THREE.Vector3(0, 0, Math.max(-size[1], Math.min(size[1], p.z)))) - size[0];
  if (shape === "ellipsoid") { // to first order, as exact as a colour needs
    const k = Math.hypot(p.x / size[0], p.y / size[1], p.z / size[2]);
    return k * (k - 1) / Math.max(1e-9, Math.hypot(p.x / size[0] ** 2, p.y / size[1] ** 2, p.z / size[2] ** 2));
  }
  const sides = shape === "cylinder"
    ? [Math.hypot(p.x, p.y) - size[0], Math.abs(p.z) - size[1]]
    : [p.x, p.y, p.z].map((value, k) => Math.abs(value) - size[k]);
  return Math.hypot(...sides.map((value) => Math.max(value, 0))) + Math.min(0, Math.max(...sides));
}

// MuJoCo's quaternions begin with w.
const turn = (mesh, [w, x, y, z]) => mesh.quaternion.set(x, y, z, w).normalize();

// What a ball around a place reaches, for the camera.
const around = (place, reach) => [0, 1, 2].flatMap((k) => [-1, 1].map((side) => place.map((v, i) => v + (i === k ? side * reach : 0))));

class Solids {
  constructor(canvas) {
    // What is drawn stays readable: saved as a picture, for instance.
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.camera = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
    this.camera.up.set(0, 0, 1);
    this.scene = new THREE.Scene();
    const sun = new THREE.DirectionalLight("#ffffff", 1.6);
    sun.position.set(0.35, -0.6, 0.9);
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#9aa4b0", 1.7), sun);
    this.arms = [];
  }

  clear() {
    if (this.body) this.scene.remove(this.body);
    for (const robot of this.robots || []) this.scene.remove(robot);
    for (const group of [this.body, ...this.robots || []]) group?.traverse((part) => { part.geometry?.dispose(); part.material?.dispose(); });
    this.robots = [];
  }

  // The geoms of a scene: those that rest, and for each of its robots, one a colour, those that move.
  showGeoms(geoms, colours) {
    this.clear();
    const solid = (geom, colour) => {
      const [red, green, blue, opacity] = geom.colour;
      const made = new THREE.MeshStandardMaterial({ roughness: 0.6, transparent: opacity < 1, opacity,
        color: colour || new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace) });
      const mesh = new THREE.Mesh(geometryOf(geom), made);
      mesh.position.set(...geom.position);
      turn(mesh, geom.turn);
      return mesh;
    };
    const resting = geoms.filter((geom) => !geom.moves), moving = geoms.filter((geom) => geom.moves);
    this.body = new THREE.Group();
    for (const geom of resting) this.body.add(solid(geom));
    this.near = resting.filter((geom) => geom.reach);
    this.robots = colours.map((colour) => {
      const robot = new THREE.Group();
      for (const geom of moving) robot.add(solid(geom, colour));
      if (colour) robot.children.forEach((mesh) => mesh.scale.setScalar(0.96)); // hidden where both agree
      return robot;
    });
    this.scene.add(this.body, ...this.robots);
  }

  // `poses` of each robot: of every geom that moves, its place and its quaternion.
  drawGeoms(poses) {
    while (this.arms.length) { const old = this.arms.pop(); this.scene.remove(old); old.dispose(); }
    poses.forEach((geoms, k) => geoms.forEach(({ place, quaternion }, i) => {
      const mesh = this.robots[k].children[i];
      mesh.position.set(...place);
      turn(mesh, quaternion);
    }));
    this.renderer.render(this.scene, this.camera);
  }

  show(object) {
    this.clear();
    const mesh = new THREE.Mesh(geometryOf(object), new THREE.MeshStandardMaterial({
      color: "#d9c98f", roughness: 0.9, transparent: true, opacity: 0.45, depthWrite: false, side: THREE.DoubleSide }));
    const edges = new THREE.LineSegments(new THREE.EdgesGeometry(mesh.geometry, 40), new THREE.LineBasicMaterial({ color: "#8d7d45" }));
    this.body = new THREE.Group().add(mesh, edges);
    this.place = placeOf(object);
    this.body.applyMatrix4(this.place);
    this.inwards = this.place.clone().invert();
    this.object = object;
    this.scene.add(this.body);
  }

  // Corners of the object's own box, for the camera.
  corners() {
    if (this.robots.length) return this.near.flatMap((geom) => around(geom.position, geom.reach));
    const box = new THREE.Box3().setFromObject(this.body);
    return [0, 1, 2, 3, 4, 5, 6, 7].map((k) => [0, 1, 2].map((axis) => (k >> axis & 1 ? box.max : box.min).getComponent(axis)));
  }

  draw(arms, radius) {
    while (this.arms.length) { const old = this.arms.pop(); this.scene.remove(old); old.dispose(); }
    for (const arm of arms) this.add(arm, radius * (arm.thin || 1));
    this.renderer.render(this.scene, this.camera);
  }

  // How deep the surface of a link is inside the object at a point of its axis.
  depth(point, radius) { return radius - distanceTo(this.object, point.clone().applyMatrix4(this.inwards)); }

  add(arm, radius) {
    const rod = new THREE.CylinderGeometry(radius, radius, 1, 20, 1, true), ball = new THREE.SphereGeometry(radius, 20, 14);
    const links = arm.points.length - 1, points = arm.points.map(at);
    const parts = [false, true].map((inside) => ({ rods: this.many(rod, links * PIECES, inside), balls: this.many(ball, links + 1, inside) }));
    const put = (kind, point, matrix, i) => {
      const inside = !arm.thin && this.depth(point, radius) > INSIDE;
      const mesh = parts[Number(inside)][kind];
      mesh.setMatrixAt(mesh.count, matrix);
      mesh.setColorAt(mesh.count++, new THREE.Color(inside ? INSIDE_COLOUR : arm.colour(i)));
    };
    points.forEach((point, i) => put("balls", point, new THREE.Matrix4().setPosition(point), Math.min(i, links - 1)));
    for (let i = 0; i < links; i++) {
      const along = points[i + 1].clone().sub(points[i]);
      const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.clone().normalize());
      const size = new THREE.Vector3(1, along.length() / PIECES, 1);
      for (let k = 0; k < PIECES; k++) {
        const middle = points[i].clone().addScaledVector(along, (k + 0.5) / PIECES);
        put("rods", middle, new THREE.Matrix4().compose(middle, turn, size), i);
      }
    }
  }

  // As many copies of a geometry as are put; what is inside the object is drawn last, over all that hides it.
  many(geometry, most, inside) {
    const mesh = new THREE.InstancedMesh(geometry, new THREE.MeshStandardMaterial({ roughness: 0.5, depthTest: !inside }), most);
    mesh.material.transparent = inside; // such things come after the object
    mesh.renderOrder = Number(inside);
    mesh.count = 0;
    mesh.frustumCulled = false;
    this.scene.add(mesh);
    this.arms.push(mesh);
    return mesh;
  }

  // Turns the camera, and puts it just so far off that all points fill the picture.
  fit({ azimuth, elevation }, points, width, height) {
    const towards = at([Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)]);
    const { camera } = this;
    camera.aspect = width / height;
    camera.position.copy(towards);
    camera.lookAt(0, 0, 0);
    camera.updateMatrixWorld();
    const [right, up] = [0, 1].map((axis) => new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, axis));
    const tangent = Math.tan(camera.fov * Math.PI / 360);
    const [wide, high] = [0.86 * tangent * camera.aspect, 0.8 * tangent];
    // Along an axis of the picture, x = offset + slope · depth is seen at the edge: the tightest pair of planes.
    const fitted = (axis, slope) => {
      const ends = [1, -1].map((side) => Math.max(...points.map((p) => side * at(p).dot(axis) + slope * at(p).dot(towards))));
      return { middle: (ends[0] - ends[1]) / 2, depth: (ends[0] + ends[1]) / 2 / slope };
    };
    const [x, y] = [fitted(right, wide), fitted(up, high)];
    camera.position.copy(right.multiplyScalar(x.middle).addScaledVector(up, y.middle).addScaledVector(towards, Math.max(x.depth, y.depth)));
    camera.updateProjectionMatrix();
    camera.updateMatrixWorld();
  }

  size(width, height) {
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2)); // in the screen's own pixels, so that it is sharp
    this.renderer.setSize(width, height);
  }
}
