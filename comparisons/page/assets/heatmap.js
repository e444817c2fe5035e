"use strict";
// Solver × solver: digits of dθ in common.

function heatmap(box, series, agreement) {
  if (!series.length) return;
  let answer = 0, statistic = 0, scope = 0;
  const statistics = [["worst", "worst step"], ["median", "median step"]];
  const formulations = [...new Set(series.map((one) => one.formulation))];
  const first = Math.max(0, formulations.indexOf("lexicographic"));
  const scopes = [...formulations.map((name) => [name]), formulations];
  scope = first;
  const told = el("p", { class: "told" }, "");
  const table = el("table", { class: "heat" });
  const again = () => draw();
  box.append(
    el("div", { class: "controls" },
      choice("Answer", agreement.map((kind) => kind.label), answer, (i) => { answer = i; again(); }).label,
      choice("On the", statistics.map(([, label]) => label), statistic, (i) => { statistic = i; again(); }).label,
      choice("Solvers", [...formulations, "all"], scope, (i) => { scope = i; again(); }).label),
    el("div", { class: "scroll", tabindex: 0, role: "region", "aria-label": "Digits of agreement" }, table),
    told, key(),
    el("p", { class: "note" }, "Where rows bind, directions can be left whose share of the cost is next to nothing. Own answers of the same "
      + "cost and dX then differ in dθ; the polish makes one certified step of them, which is the step that the arm takes."));
  draw();

  function draw() {
    const [name, label] = statistics[statistic];
    const matrix = agreement[answer][name];
    const everyone = scope === scopes.length - 1;
    const members = series.flatMap((one, i) => (scopes[scope].includes(one.formulation) && (everyone || !one.aside) ? [i] : []));
    // As large as the place allows, within limits: many solvers scroll.
    const room = (box.clientWidth - 170) / members.length;
    table.style.setProperty("--cell", `${Math.max(26, Math.min(36, Math.floor(room)))}px`);
    const starts = (k) => k > 0 && series[members[k]].formulation !== series[members[k - 1]].formulation;
    const head = el("tr", {}, el("th"), ...members.map((j, k) =>
      el("th", { scope: "col", class: starts(k) ? "starts" : "" }, el("span", {}, series[j].label))));
    const lines = members.map((i, k) => el("tr", { class: starts(k) ? "starts" : "" },
      el("th", { scope: "row", title: series[i].label }, series[i].label),
      ...members.map((j, l) => cell(matrix[i][j], i, j, starts(l), label))));
    table.replaceChildren(el("thead", {}, head), el("tbody", {}, ...lines));
    told.textContent = "Point at a square to read it.";
  }

  function cell(value, i, j, starts, label) {
    const node = el("td", { class: `${value === null ? "none" : ""} ${starts ? "starts" : ""}` });
    node.textContent = i === j ? "" : value === null ? "·" : String(Math.floor(value));
    if (i !== j && value !== null) {
      const { fill, ink } = shade(value);
      node.style.background = fill;
      node.style.color = ink;
    }
    const tell = () => {
      if (i === j) return;
      told.textContent = `${series[i].label} and ${series[j].label}: ` + (value === null ? "no step in common."
        : value >= 16 ? `the same to all 16 digits on the ${label}.` : `${value} digits on the ${label}.`);
    };
    node.addEventListener("pointerenter", tell);
    node.addEventListener("click", tell);
    return node;
  }

  function key() {
    const steps = el("span", { class: "steps" });
    for (let d = 0; d <= 16; d++) { const i = el("i"); i.style.background = shade(d).fill; steps.append(i); }
    return el("div", { class: "scale" }, "0 digits", steps, "16, every bit", el("span", {}, "· no step in common"));
  }
}

function shade(digits) {
  // Orange below the six digits that a verdict asks for, blue above: told apart by colour-blind readers.
  const mix = (a, b, t) => a.map((v, k) => Math.round(v + (b[k] - v) * t));
  const [orange, pale, light, blue] = [[179, 67, 0], [253, 224, 196], [222, 235, 247], [8, 69, 130]];
  const t = digits < 6 ? digits / 6 : (digits - 6) / 10;
  const colour = digits < 6 ? mix(orange, pale, t) : mix(light, blue, t);
  const dark = 0.299 * colour[0] + 0.587 * colour[1] + 0.114 * colour[2] < 140;
  return { fill: `rgb(${colour.join(",")})`, ink: dark ? "#fff" : "#1c2127" };
}
