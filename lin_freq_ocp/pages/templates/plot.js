"use strict";

const SVG = "http://www.w3.org/2000/svg";
const MARGIN = { left: 52, right: 10, top: 8, bottom: 34 };
const DECADES = 8; // of a logarithmic axis, at most

function element(name, attributes, text) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text !== undefined) made.textContent = text;
  return made;
}

function shown(value, digits = 4) {
  if (value === null || value === undefined) return "–";
  if (value !== 0 && (Math.abs(value) < 1e-3 || Math.abs(value) >= 1e6)) return value.toExponential(1).replace("e+", "e");
  return String(Number(value.toPrecision(digits)));
}

/* Round values between two limits, about so many, and no fewer than three. */
function ticks(low, high, count) {
  const rough = (high - low) / count, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found.length < 3 && high > low ? ticks(low, high, 2 * count) : found;
}

function decades(low, high) {
  const step = Math.max(1, Math.ceil((high - low) / 5)), found = [];
  for (let power = Math.ceil(low); power <= high + 1e-9; power += step) found.push(power);
  return found;
}

/* The range of finite values, with bounds that are not far beyond them, others up to half as far, and some room. */
function range(values, bounds, others = []) {
  let low = Infinity, high = -Infinity;
  for (const value of values) if (value !== null) { low = Math.min(low, value); high = Math.max(high, value); }
  if (low > high) [low, high] = [-1, 1];
  const span = high - low || Math.abs(high) || 1;
  for (const bound of bounds) {
    if (bound !== null && bound >= low - 1.5 * span && bound <= high + 1.5 * span) {
      low = Math.min(low, bound); high = Math.max(high, bound);
    }
  }
  const reach = 0.5 * (high - low || span);
  const [first, last] = others.reduce(([a, b], value) => (value === null ? [a, b] : [Math.min(a, value), Math.max(b, value)]), [low, high]);
  [low, high] = [Math.max(first, low - reach), Math.min(last, high + reach)];
  const room = (high - low || span) * 0.06;
  return [low - room, high + room];
}

function path(points) {
  let text = "", drawing = false;
  for (const [x, y] of points) {
    if (y === null || !Number.isFinite(y)) { drawing = false; continue; }
    text += `${drawing ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`;
    drawing = true;
  }
  return text;
}

/* Draw one panel: axes, stopped bands, bounds and curves; all in the units of the axes, y as log10 where logarithmic. */
function draw(figure, panel) {
  const svg = figure.querySelector("svg");
  const width = Math.max(figure.clientWidth, 200), height = panel.wide ? 230 : 190;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.setAttribute("height", height);
  svg.setAttribute("aria-label", panel.words);
  const inner = { width: width - MARGIN.left - MARGIN.right, height: height - MARGIN.top - MARGIN.bottom };
  const [x0, x1] = panel.x, [y0, y1] = panel.y;
  const px = (x) => MARGIN.left + ((x - x0) / (x1 - x0)) * inner.width;
  const py = (y) => MARGIN.top + (1 - (Math.min(Math.max(y, y0 - (y1 - y0)), y1 + (y1 - y0)) - y0) / (y1 - y0)) * inner.height;
  const bottom = MARGIN.top + inner.height, right = MARGIN.left + inner.width;
  const parts = [];
  const clip = `clip-${figure.dataset.index}`;
  const clipping = element("clipPath", { id: clip });
  clipping.append(element("rect", { x: MARGIN.left, y: MARGIN.top - 1, width: inner.width, height: inner.height + 2 }));
  parts.push(clipping);
  for (const [low, high] of panel.stopped || []) {
    parts.push(element("rect", { class: "band", x: px(low), y: MARGIN.top, width: Math.max(px(high) - px(low), 1), height: inner.height }));
  }
  for (const y of panel.log ? decades(y0, y1) : ticks(y0, y1, 4)) {
    parts.push(element("path", { class: "tick", d: `M${MARGIN.left} ${py(y)}H${right}` }));
    parts.push(element("text", { x: MARGIN.left - 6, y: py(y) + 4, "text-anchor": "end" }, panel.log ? `1e${y}` : shown(y)));
  }
  for (const x of ticks(x0, x1, Math.max(2, Math.floor(inner.width / 75)))) {
    parts.push(element("path", { class: "axis", d: `M${px(x)} ${bottom}v4` }));
    parts.push(element("text", { x: px(x), y: bottom + 16, "text-anchor": "middle" }, shown(x)));
  }
  parts.push(element("path", { class: "axis", d: `M${MARGIN.left} ${bottom}H${right}` }));
  parts.push(element("text", { x: (MARGIN.left + right) / 2, y: height - 3, "text-anchor": "middle" }, panel.xLabel));
  const curves = element("g", { "clip-path": `url(#${clip})` });
  for (const curve of panel.curves) {
    curves.append(element("path", { class: curve.kind, d: path(curve.points.map(([x, y]) => [px(x), y === null ? null : py(y)])) }));
  }
  svg.replaceChildren(...parts, curves);
}
