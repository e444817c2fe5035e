"use strict";
// The windings or scenes in three dimensions: play, scrub, choose the solver, lay a second one over the first.

const SECONDS = 8; // that a winding plays for at the usual speed
const FREE = ["#3f7fb8", "#2b628f"]; // neighbours differ, so that links show
const TOUCHING = ["#e06a10", "#b94f00"];
const OTHER = ["#9a9aa3", "#7f7f88"];

class Replay {
  constructor(box, replays) {
    this.windings = replays.windings;
    this.every = replays.every;
    if (!document.createElement("canvas").getContext("webgl2")) {
      box.append(el("p", { class: "note" }, "The replay needs WebGL 2, which this browser does not have here."));
      return;
    }
    if (!this.windings.length) { box.append(el("p", {}, "Nothing was driven in this run: recorded problems do not say which robot posed them.")); return; }
    this.ofScenes = Boolean(this.windings[0].geoms);
    if (this.ofScenes) {
      document.querySelector("#replay .how").textContent = "The robot as each solver drove it through the scene, the second solver in grey; drag the picture to turn it.";
    }
    this.cases = [...new Set(this.windings.map((one) => one.case))];
    this.frame = 0;
    this.playing = false;
    this.speed = 1;
    this.build(box);
    this.chooseCase(0);
    redrawn(this.stage, () => this.draw());
  }

  build(box) {
    this.caseChoice = choice(this.ofScenes ? "Scene" : "Winding", this.cases, 0, (i) => this.chooseCase(i));
    this.solverChoice = choice("Solver", [], 0, (i) => this.choose(i, this.other));
    this.otherChoice = choice("Laid over it", [], 0, (i) => this.choose(this.solver, i - 1));
    const speeds = [0.25, 1, 4];
    this.speedChoice = choice("Speed", speeds.map((s) => `${s} ×`), 1, (i) => { this.speed = speeds[i]; });
    this.canvas = el("canvas", { "aria-label": this.ofScenes ? "The robot" : "The arm", role: "img" });
    this.status = el("p", { class: "status" });
    this.solids = new Solids(this.canvas);
    this.stage = el("div", { class: "stage" }, this.canvas, this.status);
    this.button = el("button", { type: "button", class: "button main", onclick: () => this.play(!this.playing) }, "Play");
    this.slider = el("input", { type: "range", class: "slider", min: 0, max: 0, step: 1, value: 0, "aria-label": "Step",
      oninput: () => { this.play(false); this.go(Number(this.slider.value)); } });
    this.roll = el("canvas", { class: "roll", "aria-label": "Contact of each link over the steps", role: "img" });
    this.numbers = el("dl", { class: "numbers" });
    const swatch = (colour, text) => { const i = el("i"); i.style.background = colour; return el("span", {}, i, text); };
    const controls = el("div", { class: "controls" }, this.caseChoice.label, this.solverChoice.label, this.otherChoice.label,
      this.speedChoice.label, this.button);
    const meshes = Math.max(...this.windings.map((one) => one.meshes || 0));
    if (this.ofScenes) box.append(controls, this.stage, this.slider, this.numbers);
    else box.append(
      controls, this.stage, this.slider, this.roll,
      el("div", { class: "key" }, swatch(TOUCHING[0], "link in contact"), swatch(FREE[0], "link in the air"),
        swatch(INSIDE_COLOUR, "inside the object"), swatch(OTHER[0], "second solver"), el("span", {}, "Strip: links from the base (bottom) to the tip (top), over the steps")),
      this.numbers);
    if (meshes) box.append(el("p", { class: "note" }, "Meshes are shown as the boxes that hold them."));
    if (this.every > 1) box.append(el("p", { class: "note" }, `Every ${this.every}th state is kept, for the size of this page.`));
    this.drag();
    this.roll.addEventListener("pointerdown", (event) => {
      const rect = this.roll.getBoundingClientRect();
      this.play(false);
      this.go(Math.round((event.clientX - rect.left) / rect.width * (this.motion.count - 1)));
    });
  }

  chooseCase(i) {
    this.inCase = this.windings.filter((one) => one.case === this.cases[i]);
    const before = this.winding?.label;
    const names = this.inCase.map((one) => one.label);
    const fill = (select, labels) => select.replaceChildren(...labels.map((label, k) => el("option", { value: k }, label)));
    fill(this.solverChoice.select, names);
    fill(this.otherChoice.select, ["–", ...names]);
    const first = this.inCase.findIndex((one) => one.formulation === "lexicographic");
    const chosen = names.includes(before) ? names.indexOf(before) : Math.max(0, first);
    this.angles = null;
    this.frame = 0;
    this.choose(chosen, -1);
    this.go(this.motion.count - 1); // a wound arm says more than a straight one
  }

  choose(solver, other) {
    this.solver = solver;
    this.other = other;
    this.solverChoice.select.value = solver;
    this.otherChoice.select.value = other + 1;
    this.winding = this.inCase[solver];
    const share = this.motion ? this.frame / Math.max(1, this.motion.count - 1) : 0;
    this.motion = motionOf(this.winding);
    this.second = other >= 0 ? motionOf(this.inCase[other]) : null;
    if (this.ofScenes) this.solids.showGeoms(this.winding.geoms, this.second ? [null, OTHER[0]] : [null]);
    else this.solids.show(this.winding.object);
    this.angles = this.angles || (this.ofScenes ? { azimuth: -0.9, elevation: 0.4 } : firstAngles(this.winding.object));
    this.slider.max = this.motion.count - 1;
    this.tell();
    this.go(Math.round(share * (this.motion.count - 1)));
  }

  tell() {
    const one = this.winding;
    const outcomes = { WOUND: "wound", LOST: "lost contact", OUT_OF_STEPS: "no end", SOLVER_FAILED: "the solver failed",
      REACHED: "tasks met", OUT_OF_REACH: "out of reach", STUCK: "held back by limits" };
    const show = (value, factor, digits, unit) => (value === null ? "–" : `${(value * factor).toFixed(digits)}${unit}`);
    const pairs = [["outcome", outcomes[one.outcome] || one.outcome], ["steps", String(this.motion.steps[this.motion.count - 1])]];
    if (this.ofScenes) pairs.push(["largest error of a required task", one.error === null ? "–" : figure(one.error)]);
    else pairs.push(
      ["turns", show(one.turns, 1, 2, "")], ["of the ideal", show(one.turns_ratio, 1, 2, "")],
      ["penetration", show(one.penetration, 1e3, 1, " mm")], ["largest bend", show(one.bend, 1, 2, " rad")],
      ["drift", show(one.drift, 1e3, 1, " mm")],
    );
    this.numbers.replaceChildren(...pairs.map(([name, text]) => el("div", {}, el("dt", {}, name), el("dd", {}, text))));
    if (one.message) this.numbers.append(el("div", {}, el("dt", {}, "message"), el("dd", {}, one.message)));
  }

  play(on) {
    if (on && this.frame >= this.motion.count - 1) this.go(0);
    this.playing = on;
    this.button.textContent = on ? "Pause" : "Play";
    if (!on) return;
    let last = null, place = this.frame;
    const tick = (now) => {
      if (!this.playing) return;
      if (last !== null) place += (now - last) / 1000 * this.speed * (this.motion.count - 1) / SECONDS;
      last = now;
      // Another winding may have been chosen on the way.
      if (Math.abs(place - this.frame) > 0.2 * this.motion.count) place = this.frame;
      this.go(Math.min(Math.floor(place), this.motion.count - 1));
      if (this.frame >= this.motion.count - 1) this.play(false);
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  go(frame) {
    this.frame = Math.max(0, Math.min(frame, this.motion.count - 1));
    this.slider.value = this.frame;
    this.draw();
  }

  draw() {
    const width = this.stage.clientWidth;
    if (!width || !this.motion) return;
    const height = Math.round(Math.max(300, Math.min(560, width * 0.56)));
    this.solids.size(width, height);
    this.solids.fit(this.angles, this.toSee(), width, height);
    if (this.ofScenes) {
      const frames = this.second ? [[this.motion, this.frame], [this.second, this.secondFrame()]] : [[this.motion, this.frame]];
      this.solids.drawGeoms(frames.map(([motion, frame]) => motion.poses(frame)));
      this.status.textContent = `step ${this.motion.steps[this.frame]} of ${this.motion.steps[this.motion.count - 1]}`;
      return;
    }
    const arms = [{ points: this.motion.points(this.frame), colour: (i) => (this.motion.touches(this.frame, i) ? TOUCHING : FREE)[i % 2] }];
    if (this.second) {
      const frame = this.secondFrame();
      arms.push({ points: this.second.points(frame), colour: (i) => OTHER[i % 2], thin: 0.8 }); // hidden where both agree
    }
    this.solids.draw(arms, this.winding.radius);
    let touching = 0;
    for (let i = 0; i < this.motion.links; i++) touching += this.motion.touches(this.frame, i);
    this.status.textContent = `step ${this.motion.steps[this.frame]} of ${this.motion.steps[this.motion.count - 1]}`
      + ` · ${touching} of ${this.motion.links} links in contact`;
    this.drawRoll(width);
  }

  toSee() {
    // The object, and the arm from now on: the view comes closer as the arm winds up, and never swings back.
    const points = this.solids.corners();
    const last = this.motion.count - 1;
    for (let k = 0; k <= 6; k++) points.push(...this.motion.points(Math.round(this.frame + (last - this.frame) * k / 6)));
    if (this.second) points.push(...this.second.points(this.secondFrame()));
    return points;
  }

  secondFrame() {
    // The same share of its own steps.
    return Math.round(this.frame * (this.second.count - 1) / Math.max(1, this.motion.count - 1));
  }

  drawRoll(width) {
    const { count, links } = this.motion;
    const row = links > 24 ? 3 : 4;
    const context = sized(this.roll, width, row * links);
    context.fillStyle = "#e4ebf2";
    context.fillRect(0, 0, width, row * links);
    context.fillStyle = TOUCHING[0];
    for (let i = 0; i < links; i++) {
      for (let from = 0; from < count; from++) {
        if (!this.motion.touches(from, i)) continue;
        let to = from;
        while (to + 1 < count && this.motion.touches(to + 1, i)) to++;
        context.fillRect(from / count * width, row * (links - 1 - i), (to + 1 - from) / count * width, row - 1);
        from = to;
      }
    }
    context.fillStyle = "#1c2127";
    context.fillRect(Math.min(width - 2, this.frame / Math.max(1, count - 1) * width - 1), 0, 2, row * links);
  }

  drag() {
    let from = null;
    this.canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; this.canvas.setPointerCapture(event.pointerId); });
    this.canvas.addEventListener("pointerup", () => { from = null; });
    this.canvas.addEventListener("pointercancel", () => { from = null; });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      this.angles.azimuth -= 0.01 * (event.clientX - from[0]);
      this.angles.elevation = Math.max(-1.5, Math.min(1.5, this.angles.elevation + 0.01 * (event.clientY - from[1])));
      from = [event.clientX, event.clientY];
      this.draw();
    });
  }
}

function sized(canvas, width, height) {
  // In the screen's own pixels, so that it is sharp.
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    canvas.style.height = `${height}px`;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

function motionOf(winding) {
  // The arrays of replays.py, read once.
  if (winding.motion) return winding.motion;
  const bytes = bytesOf(winding.positions);
  const whole = new DataView(bytes.buffer);
  if (winding.geoms) return (winding.motion = sceneMotion(winding, whole));
  const bits = bytesOf(winding.contact);
  const { links, unit, centre, at } = winding;
  const perState = Math.ceil(links / 8);
  winding.motion = {
    links, count: at.length, steps: at,
    points: (frame) => {
      const points = [[0, 0, 0]];
      for (let i = 0; i < links; i++) {
        points.push(centre.map((c, k) => c + unit * whole.getInt16(2 * ((frame * links + i) * 3 + k), true)));
      }
      return points;
    },
    touches: (frame, i) => (bits[frame * perState + (i >> 3)] >> (7 - (i & 7))) & 1,
  };
  return winding.motion;
}

function sceneMotion({ geoms, unit, centre, at, turns }, whole) {
  const moving = geoms.filter((geom) => geom.moves);
  const sides = new DataView(bytesOf(turns).buffer);
  const place = (frame, i) => centre.map((c, k) => c + unit * whole.getInt16(2 * ((frame * moving.length + i) * 3 + k), true));
  const quaternion = (frame, i) => [0, 1, 2, 3].map((k) => sides.getInt16(2 * ((frame * moving.length + i) * 4 + k), true));
  return {
    count: at.length, steps: at,
    points: (frame) => moving.flatMap((geom, i) => around(place(frame, i), geom.reach)),
    poses: (frame) => moving.map((_, i) => ({ place: place(frame, i), quaternion: quaternion(frame, i) })),
  };
}

function firstAngles(object) {
  // Obliquely along the object's axis.
  const axis = [0, 1, 2].map((k) => object.rotation[k][2]);
  const along = at(axis).multiplyScalar(axis[1] < 0 || Math.abs(axis[2]) > 0.5 ? 0.8 : -0.8);
  const towards = along.add(at([0.45, -0.55, 0.55])).normalize();
  return { azimuth: Math.atan2(towards.y, towards.x), elevation: Math.asin(towards.z) };
}
