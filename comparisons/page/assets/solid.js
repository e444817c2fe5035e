"use strict";
// A small painter of solids on a canvas: faces of the wound object and round links, sorted by depth, the farthest first.

const vec = {
  add: (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]],
  sub: (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]],
  mul: (a, s) => [a[0] * s, a[1] * s, a[2] * s],
  dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
  cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
  unit: (a) => vec.mul(a, 1 / (Math.hypot(...a) || 1)),
  mix: (a, b, t) => vec.add(vec.mul(a, 1 - t), vec.mul(b, t)),
};

function camera(target, distance, azimuth, elevation, width, height) {
  const towards = [Math.cos(elevation) * Math.cos(azimuth), Math.cos(elevation) * Math.sin(azimuth), Math.sin(elevation)];
  const eye = vec.add(target, vec.mul(towards, distance));
  const forward = vec.mul(towards, -1);
  const right = vec.unit(vec.cross(forward, [0, 0, 1]));
  const up = vec.cross(right, forward);
  const focal = 1.6 * Math.min(width, height * 1.5);
  return { eye, right, up, see: (p) => {
    const d = vec.sub(p, eye);
    const depth = vec.dot(d, forward);
    const size = focal / depth;
    return { x: width / 2 + size * vec.dot(d, right), y: height / 2 - size * vec.dot(d, up), depth, size };
  } };
}

// Faces of the object: corners in the world and the outward normal. MuJoCo's half-sizes.
function facesOf(object) {
  const { shape, size } = object;
  const local = [];
  const grid = (nu, nv, at) => {
    for (let i = 0; i < nu; i++) for (let j = 0; j < nv; j++) {
      local.push([at(i / nu, j / nv), at((i + 1) / nu, j / nv), at((i + 1) / nu, (j + 1) / nv), at(i / nu, (j + 1) / nv)]);
    }
  };
  const turn = (u, r, z) => [r * Math.cos(2 * Math.PI * u), r * Math.sin(2 * Math.PI * u), z];
  if (shape === "cylinder") {
    const [r, h] = size;
    grid(40, 8, (u, v) => turn(u, r, h * (2 * v - 1)));
    grid(40, 2, (u, v) => turn(u, r * (1 - v), h));
    grid(40, 2, (u, v) => turn(u, r * v, -h));
  } else if (shape === "box") {
    for (const axis of [0, 1, 2]) for (const side of [-1, 1]) {
      const [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
      grid(5, 5, (u, v) => {
        const p = [0, 0, 0];
        p[axis] = side * size[axis]; p[a] = size[a] * (2 * u - 1); p[b] = side * size[b] * (2 * v - 1);
        return p;
      });
    }
  } else { // sphere, ellipsoid, capsule: a ball, stretched or pulled apart
    const radii = shape === "ellipsoid" ? size : [size[0], size[0], size[0]];
    const half = shape === "capsule" ? size[1] : 0;
    grid(32, 20, (u, v) => {
      const up = Math.PI * (v - 0.5);
      const [x, y, z] = turn(u, Math.cos(up), Math.sin(up));
      return [radii[0] * x, radii[1] * y, radii[2] * z + half * Math.sign(v - 0.5)];
    });
  }
  const world = ([x, y, z]) => object.position.map((p, k) =>
    p + object.rotation[k][0] * x + object.rotation[k][1] * y + object.rotation[k][2] * z);
  return local.map((corners) => {
    const at = corners.map(world);
    const normal = vec.unit(vec.cross(vec.sub(at[2], at[0]), vec.sub(at[3], at[1])));
    return { at, normal, middle: at.reduce((sum, p) => vec.add(sum, vec.mul(p, 0.25)), [0, 0, 0]) };
  });
}

const LIGHT = vec.unit([0.35, -0.6, 0.9]);
const PIECES = 4; // of each link: the shorter, the better they sort

function paint(context, view, faces, arms, radius) {
  const list = [];
  for (const face of faces) {
    if (vec.dot(face.normal, vec.sub(view.eye, face.middle)) <= 0) continue;
    list.push({ depth: view.see(face.middle).depth, draw: () => paintFace(context, view, face) });
  }
  for (const arm of arms) {
    const thick = radius * (arm.thin || 1);
    const behind = arm.thin ? 1.5 * radius : 0; // where two arms are in one place, the first is seen
    arm.points.slice(1).forEach((end, i) => {
      const start = arm.points[i];
      const colours = arm.colours(i);
      const joint = view.see(start);
      list.push({ depth: joint.depth + 0.001 + behind, draw: () => paintBall(context, joint, thick, colours) });
      if (i === arm.points.length - 2) {
        const tip = view.see(end);
        list.push({ depth: tip.depth + 0.001 + behind, draw: () => paintBall(context, tip, thick, colours) });
      }
      for (let k = 0; k < PIECES; k++) {
        const [a, b] = [view.see(vec.mix(start, end, k / PIECES)), view.see(vec.mix(start, end, (k + 1) / PIECES))];
        list.push({ depth: (a.depth + b.depth) / 2 + behind, draw: () => paintPiece(context, a, b, thick, colours) });
      }
    });
  }
  list.sort((a, b) => b.depth - a.depth);
  for (const item of list) item.draw();
}

function paintFace(context, view, face) {
  const light = 0.62 + 0.38 * Math.max(0, vec.dot(face.normal, LIGHT));
  context.fillStyle = context.strokeStyle = `rgb(${[226, 215, 178].map((v) => Math.round(v * light)).join(",")})`;
  context.lineWidth = 1;
  context.beginPath();
  face.at.map(view.see).forEach((p, i) => (i ? context.lineTo(p.x, p.y) : context.moveTo(p.x, p.y)));
  context.closePath();
  context.fill();
  context.stroke(); // closes the hairlines between faces
}

function paintPiece(context, a, b, radius, [dark, main, bright]) {
  const length = Math.hypot(b.x - a.x, b.y - a.y);
  if (length < 0.2) return;
  const [tx, ty] = [(b.x - a.x) / length, (b.y - a.y) / length];
  let [nx, ny] = [-ty, tx];
  if (ny > 0) [nx, ny] = [-nx, -ny]; // towards the light, which comes from above
  const [wa, wb] = [radius * a.size, radius * b.size];
  const w = Math.max(wa, wb);
  const across = context.createLinearGradient(a.x + nx * w, a.y + ny * w, a.x - nx * w, a.y - ny * w);
  across.addColorStop(0, main); across.addColorStop(0.3, bright); across.addColorStop(0.62, main); across.addColorStop(1, dark);
  context.fillStyle = across;
  const more = Math.min(0.6, length); // closes the hairline to the next piece
  context.beginPath();
  context.moveTo(a.x + nx * wa - tx * more, a.y + ny * wa - ty * more);
  context.lineTo(b.x + nx * wb + tx * more, b.y + ny * wb + ty * more);
  context.lineTo(b.x - nx * wb + tx * more, b.y - ny * wb + ty * more);
  context.lineTo(a.x - nx * wa - tx * more, a.y - ny * wa - ty * more);
  context.closePath();
  context.fill();
}

function paintBall(context, p, radius, [dark, main, bright]) {
  const r = radius * p.size;
  const shine = context.createRadialGradient(p.x, p.y - 0.4 * r, 0.1 * r, p.x, p.y, r);
  shine.addColorStop(0, bright); shine.addColorStop(0.5, main); shine.addColorStop(1, dark);
  context.fillStyle = shine;
  context.beginPath();
  context.arc(p.x, p.y, r, 0, 2 * Math.PI);
  context.fill();
}
