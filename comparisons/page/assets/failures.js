"use strict";
// Failures as cards, with problems to download.

function failureCards(box, failures, rankTolerance) {
  const { groups, files } = failures;
  if (!groups.length) {
    box.append(el("p", {}, "None found among the replayed steps and the driven episodes."));
    return;
  }
  const cards = groups.map((group) => el("div", { class: "card" },
    el("p", {}, el("b", {}, group.solver), ` ${group.what}`),
    el("p", {}, `${group.count} of ${group.asked} ${group.windings ? "episodes" : "steps"}`),
    ...(group.message ? [el("p", { class: "message", title: group.message }, group.message)] : []),
    el("ul", {}, ...group.examples.map((one) => el("li", {}, link(one))))));
  const whole = el("div", { class: "cards" }, ...cards.slice(0, 12));
  box.append(whole);
  if (cards.length > 12) {
    const more = el("button", { type: "button", class: "button", onclick: () => { whole.append(...cards.slice(12)); more.remove(); } },
      `Show the other ${cards.length - 12}`);
    box.append(el("p", {}, more));
  }
  if (Object.keys(files).length) {
    box.append(el("p", { class: "note" }, "A problem is a .npz file of plain arrays. To solve it with a solver of your choice:"),
      el("pre", {}, 'import prioritized_ik as pik\n\n'
        + `options = pik.SolveOptions(rank_tolerance=${rankTolerance})\n`
        + 'problem = pik.load_problem("up-112.npz")\nprint(pik.solve(problem, solver="daqp", options=options).certificate)'));
  }

  function link(one) {
    const name = one.step === null ? one.case : `${one.case} step ${one.step}`;
    if (!one.file) return name;
    return el("button", { type: "button", class: "link", title: "download the problem", onclick: () => {
      const url = URL.createObjectURL(new Blob([bytesOf(files[`${one.case} ${one.step}`])], { type: "application/octet-stream" }));
      el("a", { href: url, download: `${one.case}-${one.step}.npz`.replace(/[^\w.=-]+/g, "_") }).click();
      setTimeout(() => URL.revokeObjectURL(url), 1000);
    } }, `${name} ↓`);
  }
}
