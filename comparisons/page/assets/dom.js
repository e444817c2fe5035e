"use strict";
// Small helpers. Text from the data goes into the page as text only, never as markup.

const SVG = "http://www.w3.org/2000/svg";

function el(name, attributes = {}, ...children) {
  return filled(document.createElement(name), attributes, children);
}

function svg(name, attributes = {}, ...children) {
  return filled(document.createElementNS(SVG, name), attributes, children);
}

function filled(node, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else node.setAttribute(key, value);
  }
  node.append(...children);
  return node;
}

function choice(title, labels, chosen, changed) {
  const select = el("select", { "aria-label": title, onchange: () => changed(Number(select.value)) });
  labels.forEach((label, i) => select.append(el("option", { value: i }, label)));
  select.value = chosen;
  return { label: el("label", {}, title, select), select };
}

function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return bytes;
}

function figure(value) {
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 0.01 && size < 1e4) return String(Number(value.toPrecision(3)));
  return value.toExponential(1).replace(".0e", "e").replace("e+", "e");
}

function redrawn(node, draw) {
  // Draws now, and again whenever the width changes.
  let width = -1;
  new ResizeObserver(() => {
    if (node.clientWidth !== width) { width = node.clientWidth; draw(width); }
  }).observe(node);
}

// Okabe and Ito's colours, told apart by colour-blind readers, the yellow darkened; beyond eight, the dashes differ.
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#b58900", "#3c3c3c", "#7b61c4"];
const DASHES = ["", "7 3", "2 3", "9 3 2 3", "4 2 1 2"];

function nameWithin(one) {
  // What a series is called among those of its formulation.
  return one.label.replace(`, ${one.formulation}`, "");
}

function looks(series) {
  // A solver looks the same in every formulation of it.
  const names = series.map(nameWithin);
  const different = [...new Set(names)];
  return names.map((name) => {
    const i = different.indexOf(name);
    return { colour: COLOURS[i % COLOURS.length], dash: DASHES[Math.floor(i / COLOURS.length) % DASHES.length] };
  });
}

function stroke(look) {
  return look.dash ? { stroke: look.colour, "stroke-dasharray": look.dash } : { stroke: look.colour };
}
