"use strict";
// A line chart of many series in SVG, with one legend for several charts: chips show and hide, hovering brings one out.

const FAILED = -1; // as in courses.py

class Legend {
  constructor(series, styles) {
    this.series = series;
    this.styles = styles;
    this.charts = [];
    this.chips = series.map(() => []);
    const first = series.some((one) => one.formulation === "lexicographic") ? "lexicographic" : series[0]?.formulation;
    this.visible = new Set(series.flatMap((one, i) => (one.formulation === first && !one.aside ? [i] : [])));
  }

  view() {
    const box = el("div", { class: "legend" });
    for (const formulation of new Set(this.series.map((one) => one.formulation))) {
      const members = this.series.flatMap((one, i) => (one.formulation === formulation ? [i] : []));
      const all = el("button", { type: "button", class: "all", title: "show or hide all of these", onclick: () => {
        const shown = members.every((i) => this.visible.has(i));
        members.forEach((i) => (shown ? this.visible.delete(i) : this.visible.add(i)));
        this.changed();
      } }, formulation);
      box.append(el("div", { class: "group" }, all, ...members.map((i) => this.chip(i))));
    }
    this.changed();
    return box;
  }

  chip(i) {
    const line = svg("line", { x1: 0, x2: 22, y1: 5, y2: 5, "stroke-width": 3, ...stroke(this.styles[i]) });
    const chip = el("button", {
      type: "button", class: "chip",
      onclick: () => { this.visible.has(i) ? this.visible.delete(i) : this.visible.add(i); this.changed(); },
      onpointerenter: () => this.bringOut(i), onpointerleave: () => this.bringOut(null),
    }, svg("svg", { width: 22, height: 10, "aria-hidden": "true" }, line), nameWithin(this.series[i]));
    this.chips[i].push(chip);
    return chip;
  }

  changed() {
    this.chips.forEach((chips, i) => chips.forEach((chip) => chip.setAttribute("aria-pressed", this.visible.has(i))));
    this.charts.forEach((chart) => chart.draw());
  }

  bringOut(i) {
    this.charts.forEach((chart) => chart.bringOut(i !== null && this.visible.has(i) ? i : null));
  }
}

class Chart {
  // What to show: x values, lines (one for each series), logX, logY, steps (stairs), bands, title, xName, showX, showY.
  constructor(legend, what) {
    this.legend = legend;
    this.what = what;
    this.tip = el("div", { class: "tip", hidden: "" });
    this.box = el("div", { class: "chart" }, this.tip);
    legend.charts.push(this);
    redrawn(this.box, () => this.draw());
  }

  show(what) { this.what = { ...this.what, ...what }; this.draw(); }

  draw() {
    const width = this.box.clientWidth;
    if (!width) return;
    const { x, lines, logX, logY, title, xName, bands = [], showX = figure, showY = figure } = this.what;
    const height = Math.max(240, Math.min(340, width * 0.45));
    const edge = { left: 52, right: 12, top: 30, bottom: 42 };
    const inner = { w: width - edge.left - edge.right, h: height - edge.top - edge.bottom };
    const shown = [...this.legend.visible].sort((a, b) => a - b).filter((i) => lines[i]);
    const values = shown.flatMap((i) => lines[i].filter((v) => v !== null && v !== FAILED));
    const yRange = this.what.yRange || range(values, logY);
    const xRange = [x[0], x.length > 1 ? x[x.length - 1] : x[0] + 1];
    const px = scale(xRange, [edge.left, edge.left + inner.w], logX);
    const py = scale(yRange, [edge.top + inner.h, edge.top], logY);
    const at = (v) => py(logY ? Math.max(v, yRange[0]) : v);

    const picture = svg("svg", { width, height, viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": title });
    for (const [from, to] of bands) {
      picture.append(svg("rect", { class: "band", x: px(from), y: edge.top, width: px(to) - px(from), height: inner.h }));
    }
    for (const tick of ticks(yRange, logY, inner.h / 38)) {
      picture.append(svg("line", { class: "grid", x1: edge.left, x2: width - edge.right, y1: py(tick), y2: py(tick) }));
      picture.append(svg("text", { x: edge.left - 7, y: py(tick) + 4, "text-anchor": "end" }, showY(tick)));
    }
    for (const tick of ticks(xRange, logX, inner.w / 70)) {
      picture.append(svg("line", { class: "axis", x1: px(tick), x2: px(tick), y1: edge.top + inner.h, y2: edge.top + inner.h + 4 }));
      picture.append(svg("text", { x: px(tick), y: edge.top + inner.h + 18, "text-anchor": "middle" }, showX(tick)));
    }
    const bottom = edge.top + inner.h;
    picture.append(svg("line", { class: "axis", x1: edge.left, x2: width - edge.right, y1: bottom, y2: bottom }));
    picture.append(svg("text", { x: edge.left + inner.w / 2, y: height - 6, "text-anchor": "middle" }, xName));
    picture.append(svg("text", { class: "title", x: 0, y: 16 }, title));
    this.drawn = new Map();
    for (const i of shown) {
      const group = svg("g", {}, svg("path", { class: "line", d: this.path(lines[i], px, at), ...stroke(this.legend.styles[i]) }));
      lines[i].forEach((v, k) => {
        if (v !== FAILED) return;
        const [cx, cy] = [px(x[k]), edge.top + 5];
        group.append(svg("path", { d: `M${cx - 3} ${cy - 3}l6 6m0 -6l-6 6`, "stroke-width": 1.5, stroke: this.legend.styles[i].colour }));
      });
      picture.append(group);
      this.drawn.set(i, group);
    }
    if (!shown.length) picture.append(svg("text", { x: edge.left + inner.w / 2, y: edge.top + inner.h / 2, "text-anchor": "middle" }, "No solver chosen below."));
    picture.addEventListener("pointermove", (event) => this.point(event, shown, px, at, width));
    picture.addEventListener("pointerdown", (event) => this.point(event, shown, px, at, width));
    picture.addEventListener("pointerleave", () => { this.tip.hidden = true; this.legend.bringOut(null); });
    this.picture?.remove();
    this.picture = picture;
    this.box.append(picture);
  }

  path(line, px, at) {
    let d = "", pen = false, before = 0;
    line.forEach((v, k) => {
      if (v === null || v === FAILED) { pen = false; return; }
      const [x, y] = [px(this.what.x[k]).toFixed(1), at(v).toFixed(1)];
      d += !pen ? `M${x} ${y}` : this.what.steps ? `H${x}V${y}` : `L${x} ${y}`;
      // A lone point between gaps is still seen.
      if (!pen && (line[k + 1] === null || line[k + 1] === undefined || line[k + 1] === FAILED)) d += "h1.5";
      pen = true; before = y;
    });
    return d;
  }

  point(event, shown, px, at, width) {
    const rect = this.picture.getBoundingClientRect();
    const [mx, my] = [event.clientX - rect.left, event.clientY - rect.top];
    const { x, lines, xName, showX = figure, showY = figure } = this.what;
    let k = 0;
    x.forEach((v, j) => { if (Math.abs(px(v) - mx) < Math.abs(px(x[k]) - mx)) k = j; });
    let best = null, distance = 40;
    for (const i of shown) {
      const v = lines[i][k];
      if (v === null || v === undefined) continue;
      const d = Math.abs((v === FAILED ? 35 : at(v)) - my);
      if (d < distance) { distance = d; best = i; }
    }
    this.legend.bringOut(best);
    this.tip.hidden = best === null;
    if (best === null) return;
    const v = lines[best][k];
    this.tip.replaceChildren(el("b", {}, this.legend.series[best].label), el("br"),
      `${this.what.xShort || xName} ${showX(x[k])}: ${v === FAILED ? "no accepted answer" : showY(v)}`);
    const left = Math.min(Math.max(px(x[k]) + 12, 0), width - this.tip.offsetWidth);
    this.tip.style.left = `${left}px`;
    this.tip.style.top = `${Math.max(0, (v === FAILED ? 35 : at(v)) - this.tip.offsetHeight - 10)}px`;
  }

  bringOut(i) {
    this.drawn?.forEach((group, j) => {
      group.setAttribute("class", i !== null && j !== i ? "faint" : "");
      group.firstChild.classList.toggle("strong", j === i);
    });
    if (i !== null && this.drawn?.has(i)) this.drawn.get(i).parentNode.append(this.drawn.get(i));
  }
}

function scale([a, b], [from, to], log) {
  const place = log ? (v) => Math.log(v / a) / Math.log(b / a) : (v) => (v - a) / (b - a);
  return (v) => from + (to - from) * place(v);
}

function range(values, log) {
  if (!log) return values.length ? [Math.min(...values), Math.max(...values)] : [0, 1];
  const positive = values.filter((v) => v > 0);
  if (!positive.length) return [1e-17, 1];
  const low = Math.max(1e-17, 10 ** Math.floor(Math.log10(Math.min(...positive))));
  const high = 10 ** Math.ceil(Math.log10(Math.max(...positive)));
  return [values.some((v) => v <= 0) ? Math.min(low, 1e-17) : low, high > low ? high : low * 10];
}

function ticks([a, b], log, most) {
  if (log) {
    const decades = Math.log10(b / a);
    const found = [];
    if (decades <= 2.2) {
      for (let e = Math.floor(Math.log10(a)); e <= Math.log10(b); e++) {
        for (const m of [1, 2, 5]) found.push(m * 10 ** e);
      }
    } else {
      const step = Math.max(1, Math.ceil(decades / Math.max(most, 2)));
      for (let e = Math.round(Math.log10(a)); e <= Math.log10(b) + 1e-9; e += step) found.push(10 ** e);
    }
    return found.filter((v) => v >= a * (1 - 1e-9) && v <= b * (1 + 1e-9));
  }
  const raw = (b - a) / Math.max(most, 2);
  const unit = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * unit).find((s) => s >= raw);
  const found = [];
  for (let v = Math.ceil(a / step) * step; v <= b + 1e-9 * step; v += step) found.push(Number(v.toPrecision(12)));
  return found;
}
