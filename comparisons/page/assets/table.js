"use strict";
// The verdict table: a click on a heading sorts by it, a second one the other way round.

function verdictTable(table, verdicts) {
  const order = ["agrees", "reference", "disagrees", "fails"];
  const marks = { agrees: "✓", disagrees: "≠", fails: "✕", reference: "◦" };
  const body = el("tbody");
  const rows = verdicts.rows.map((row) => {
    const line = el("tr", { class: row.verdict });
    row.cells.forEach((text, i) => {
      const column = verdicts.columns[i];
      const isVerdict = column.name === "verdict";
      const shown = isVerdict ? el("span", { class: "pill" }, `${marks[row.verdict] || ""} ${text}`) : text;
      line.append(el(i ? "td" : "th", i ? { class: column.text ? "text" : "" } : { scope: "row" }, shown));
    });
    return { line, cells: row.cells, rank: order.indexOf(row.verdict) };
  });
  const heads = verdicts.columns.map((column, i) =>
    el("th", { scope: "col", class: column.text ? "text" : "", "aria-sort": "none" },
      el("button", { type: "button", onclick: () => sort(i) }, column.name)));
  table.append(el("thead", {}, el("tr", {}, ...heads)), body);
  body.append(...rows.map((row) => row.line));

  function sort(i) {
    const down = heads[i].getAttribute("aria-sort") === "ascending";
    heads.forEach((head) => head.setAttribute("aria-sort", "none"));
    heads[i].setAttribute("aria-sort", down ? "descending" : "ascending");
    const compare = verdicts.columns[i].name === "verdict" ? (a, b) => a.rank - b.rank || text(a, b, i)
      : verdicts.columns[i].text ? (a, b) => text(a, b, i) : (a, b) => number(a.cells[i]) - number(b.cells[i]);
    const known = (row) => row.cells[i] !== "–" && row.cells[i] !== "";
    const sorted = rows.filter(known).sort(compare);
    if (down) sorted.reverse();
    body.append(...[...sorted, ...rows.filter((row) => !known(row))].map((row) => row.line)); // what has no figure, last
  }

  function text(a, b, i) { return a.cells[i].localeCompare(b.cells[i]); }
  function number(cell) { return parseFloat(cell); }
}
