"use strict";
// Puts the data into the page.

(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const place = (id) => document.getElementById(id);
  place("finding").textContent = data.finding;
  place("legend").textContent = data.verdicts.legend;
  for (const [name, value] of data.facts) place("facts").append(el("div", {}, el("dt", {}, name), el("dd", {}, value)));
  verdictTable(place("verdict-table"), data.verdicts);
  new Replay(place("replay-view"), data.replays);
  heatmap(place("agreement-view"), data.series, data.agreement);
  const facts = new Map(data.facts);
  failureCards(place("failures-view"), data.failures, facts.get("settings: rank_tolerance"));

  const legend = new Legend(data.series, looks(data.series));
  const { ratios, kinds, first } = data.profiles;
  const percent = (v) => `${Number((100 * v).toPrecision(3))} %`;
  const speed = new Chart(legend, {
    x: ratios, lines: kinds[first].shares, logX: true, steps: true, yRange: [0, 1], title: "share of the steps answered",
    xName: "τ, times the fastest of the same formulation", xShort: "within", showX: (v) => `${figure(v)} ×`, showY: percent,
  });
  const which = choice("Counts as an answer", kinds.map((kind) => kind.label), first, (i) => speed.show({ lines: kinds[i].shares }));
  place("profiles-view").append(el("div", { class: "controls" }, which.label), speed.box, legend.view());

  if (!data.courses.length) return;
  const bandsOf = (course) => course.steps.flatMap((step, k) => {
    // From halfway to the step before, to halfway to the step after.
    if (course.free[k]) return [];
    const before = k ? course.steps[k - 1] : step, after = k + 1 < course.steps.length ? course.steps[k + 1] : step;
    return [[(step + before) / 2, (step + after) / 2]];
  });
  const shown = (course, name, title) => ({ x: course.steps, lines: course[name], bands: bandsOf(course), logY: true, xName: "step", title });
  const error = new Chart(legend, shown(data.courses[0], "error", "relative error"));
  const time = new Chart(legend, shown(data.courses[0], "time", "time of a step [ms]"));
  const winding = choice("Episode", data.courses.map((course) => course.case), 0, (i) => {
    error.show(shown(data.courses[i], "error", "relative error"));
    time.show(shown(data.courses[i], "time", "time of a step [ms]"));
  });
  place("course-view").append(el("div", { class: "controls" }, winding.label), error.box, time.box, legend.view(),
    el("p", { class: "note" }, "The error is that of the solver's own answer: of dθ and dX against Eqs. 12 to 15 on free steps, of dX against the certified step on shaded ones."));
  if (data.courses_left_out) {
    place("course-view").append(el("p", { class: "note" }, `${data.courses_left_out} episodes more are left out here, for the size of this page.`));
  }
})();
