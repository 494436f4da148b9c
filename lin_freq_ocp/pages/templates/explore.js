const DATA = JSON.parse(document.getElementById("data").textContent);
const BADGES = {
  optimal: ["holds", "optimal, proven"], locally_optimal: ["holds", "locally optimal"],
  extremal: ["", "extremal, no minimum"], infeasible: ["broken", "infeasible, proven"],
  infeasible_claimed: ["broken", "infeasible, not proven"], unbounded: ["broken", "unbounded"], limit: ["", "stopped at a limit"],
  numerical_error: ["broken", "no accurate solution"], error: ["broken", "not a problem"],
};
const KINDS = ["classical", "filtered", "constrained"]; // drawn in this order
const REST = 150; // milliseconds without a move, before the page asks for answers that take longer
const BUSY = 150; // milliseconds of a solve, after which the page says that it computes
const PAGE = String(Math.random()).slice(2);
const byId = (id) => document.getElementById(id);
const sliders = new Map(DATA.sliders.map((slider) => [slider.key, { ...slider, own: slider.value }]));
const live = DATA.points === null;
let order = 0, answer = null, compared = null, solved = null, waiting = false;

/* Sliders. */

function spoken(slider, value) {
  if (slider.key === "cutoff" && value >= slider.high) return "none";
  const decimals = Math.max(0, -Math.floor(Math.log10(slider.step)) + (slider.group === "frequency" ? 1 : 0));
  return `${Number(value.toFixed(Math.min(decimals, 12)))} ${slider.unit}`.trim();
}

function addSlider(slider) {
  const label = document.createElement("label"), input = document.createElement("input"), output = document.createElement("output");
  Object.assign(input, { type: "range", id: `slider-${slider.key}` });
  /* positions are notches, whole numbers, so that the problem's own value is one of them */
  input.min = Math.round((slider.low - slider.own) / slider.step);
  input.max = Math.round((slider.high - slider.own) / slider.step);
  input.step = 1;
  input.dataset.testid = slider.key;
  label.append(slider.label, output, input);
  slider.input = input;
  slider.output = output;
  input.addEventListener("input", () => {
    const value = slider.own + Number(input.value) * slider.step;
    set(slider, Math.min(Math.max(value, slider.low), slider.high));
    moved();
  });
  byId(`sliders-${slider.group}`).append(label);
  set(slider, slider.own);
}

function set(slider, value) {
  slider.value = value;
  const position = Math.round((value - slider.own) / slider.step);
  if (Number(slider.input.value) !== position) slider.input.value = position;
  const words = spoken(slider, value);
  slider.output.textContent = words;
  slider.input.setAttribute("aria-valuetext", words);
  slider.input.dataset.value = value;
}

function setAll(values) {
  for (const [key, value] of Object.entries(values)) set(sliders.get(key), value);
  moved();
}

const values = () => Object.fromEntries([...sliders.values()].map((slider) => [slider.key, slider.value]));

/* Answers: the newest position wins; one request is on its way at a time. */

async function ask(what, more) {
  const body = JSON.stringify({ page: PAGE, order, values: values(), ...more });
  const reply = await fetch(what, { method: "POST", body });
  const found = await reply.json();
  if (!reply.ok) throw new Error(found.error);
  return found.overtaken ? null : found;
}

function moved() {
  order += 1;
  byId("controls").dataset.moved = performance.now();
  if (!live) show(nearest());
  else if (!waiting) solve();
}

async function solve() {
  waiting = true;
  let asked = -1;
  while (asked !== order) {
    asked = order;
    const given = values(), stop = startClock();
    try {
      const found = await ask("answer");
      stop();
      if (found !== null) showAnswer(found, asked, given);
    } catch (error) {
      stop();
      const message = live && error instanceof TypeError ? "lin-freq-ocp explore has ended." : error.message;
      showAnswer({ status: "error", message }, asked, given);
    }
  }
  waiting = false;
  setTimeout(() => order === asked && afterwards(asked), REST);
}

/* Grey out badge and figures while a solve takes longer than BUSY, with its seconds; return the function that ends it. */
function startClock() {
  const begun = performance.now(), results = byId("results");
  const timer = setInterval(() => {
    const seconds = Math.floor((performance.now() - begun) / 1000);
    results.setAttribute("aria-busy", "true");
    byId("badge").textContent = seconds ? `solving, ${seconds} s` : "solving";
  }, BUSY);
  return () => {
    clearInterval(timer);
    results.setAttribute("aria-busy", "false");
  };
}

/* Answers that take longer: the other trajectories, and the smallest relaxations. */
async function afterwards(asked) {
  try {
    if (answer.frame) {
      const found = await ask("compare");
      if (order !== asked || found === null) return;
      showCompared(found);
    }
    if (answer.status !== "infeasible") return;
    byId("curing").textContent = "Looking for the smallest relaxation …";
    for (const slider of sliders.values()) {
      if (slider.value === slider.relaxed) continue;
      const found = await ask("cure", { slider: slider.key });
      if (order !== asked || found === null) return;
      if (found.value !== null) addCure({ [slider.key]: found.value });
    }
    byId("curing").textContent = byId("cures").childElementCount ? "" : "No single slider restores feasibility.";
  } catch (error) {
    if (order === asked) byId("finding").textContent = error.message;
  }
}

function showAnswer(found, asked = order, given = values()) {
  answer = found;
  const [kind, words] = BADGES[found.status] || ["", found.status];
  const badge = byId("badge"), text = found.words || {};
  badge.textContent = words;
  badge.dataset.kind = kind;
  badge.dataset.status = found.status;
  for (const what of ["cost", "gap", "bound"]) byId(what).textContent = text[what] || "–";
  byId("theorem").textContent = found.theorem || "–";
  byId("solver").textContent = text.solver ? `${text.solver}, solved and certified in ${text.seconds} ms` : found.message;
  byId("sentences").replaceChildren(...(found.proof || []).map(paragraph));
  const infeasible = found.status === "infeasible";
  byId("conflict").hidden = !infeasible;
  byId("cures").replaceChildren();
  byId("curing").textContent = "";
  if (infeasible) {
    byId("why").textContent = `No trajectory satisfies all of these together: ${listed(found.conflict)}.`;
    if (solved !== null) addCure(solved, "Back to the last solution");
  } else if (found.trajectory) solved = given;
  drawAll();
  byId("controls").dataset.drawn = performance.now();
  byId("controls").dataset.order = asked;
}

function showCompared(found) {
  compared = found;
  const names = new Map(found.trajectories.map((one) => [one.name, one]));
  for (const kind of ["classical", "filtered"]) {
    byId(`show-${kind}`).parentElement.hidden = !names.has(kind);
    byId(`cost-${kind}`).textContent = names.has(kind) && names.get(kind).meaningful ? `cost ${names.get(kind).cost}` : "";
  }
  byId("finding").textContent = found.finding ? `Filtering afterwards: ${found.finding}.` : "";
  drawAll();
}

function addCure(changes, words, from = values()) {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = words || Object.entries(changes).map(([key, value]) => {
    const slider = sliders.get(key);
    return `${slider.label}: ${spoken(slider, from[key])} → ${spoken(slider, value)}`;
  }).join(", ");
  button.addEventListener("click", () => setAll(changes));
  byId("cures").append(button);
}

function paragraph(text) {
  const made = document.createElement("p");
  made.textContent = text;
  return made;
}

const listed = (parts) => (parts.length < 2 ? parts.join("") : `${parts.slice(0, -1).join(", ")} and ${parts.at(-1)}`);

/* A solved sweep. */

function distance(point, target) {
  let sum = 0;
  for (const slider of sliders.values()) {
    const away = (point.values[slider.key] - target[slider.key]) / (slider.high - slider.low);
    sum += away * away;
  }
  return sum;
}

function nearest() {
  const target = values();
  return DATA.points.reduce((best, point) => (distance(point, target) < distance(best, target) ? point : best));
}

function show(point) {
  for (const [key, value] of Object.entries(point.values)) {
    const slider = sliders.get(key), words = spoken(slider, value);
    slider.output.textContent = words;
    slider.input.setAttribute("aria-valuetext", words);
  }
  showAnswer(point.answer);
  if (point.answer.trajectory) solved = point.values;
  showCompared(point.compared);
  if (point.answer.status !== "infeasible") return;
  for (const slider of sliders.values()) {
    const alone = DATA.points.filter((other) => other.answer.trajectory
      && [...sliders.keys()].every((key) => key === slider.key || other.values[key] === point.values[key]));
    const away = (other) => Math.abs(other.values[slider.key] - point.values[slider.key]);
    if (alone.length) {
      const closest = alone.reduce((best, other) => (away(other) < away(best) ? other : best));
      addCure({ [slider.key]: closest.values[slider.key] }, undefined, point.values);
    }
  }
}

/* Panels. */

function trajectories() {
  const T = answer.frame.horizon, fits = (one) => one.signals[0].length === T;
  const all = [...(compared ? compared.trajectories : []).filter(fits)];
  if (answer.trajectory) all.push({ name: "constrained", meaningful: true, ...answer.trajectory });
  return KINDS.flatMap((kind) => all.filter((one) => one.name === kind && byId(`show-${kind}`).checked));
}

function drawAll() {
  if (!answer.frame) {
    byId("panels").classList.add("stale");
    return;
  }
  byId("panels").classList.remove("stale");
  const frame = answer.frame, shownOnes = trajectories();
  const controls = frame.signals.flatMap((signal, i) => (signal.state ? [] : [timePanel(frame, signal, i, shownOnes)]));
  const states = frame.signals.flatMap((signal, i) => (signal.state ? [timePanel(frame, signal, i, shownOnes)] : []));
  const spectra = frame.spectra.map((spectrum, i) => spectrumPanel(frame, spectrum, i, shownOnes));
  const vibrations = frame.vibrations.map((vibration, i) => vibrationPanel(frame, vibration, i, shownOnes));
  const panels = [...controls, ...spectra, ...vibrations, ...states];
  const place = byId("panels");
  while (place.childElementCount > panels.length) place.lastChild.remove();
  while (place.childElementCount < panels.length) {
    const figure = document.createElement("figure");
    figure.append(document.createElement("figcaption"), element("svg", { role: "img" }));
    figure.dataset.index = place.childElementCount;
    place.append(figure);
  }
  panels.forEach((panel, i) => {
    const figure = place.children[i];
    figure.classList.toggle("wide", panel.wide);
    figure.firstChild.textContent = panel.title;
  });
  panels.forEach((panel, i) => draw(place.children[i], panel));
}

function timePanel(frame, signal, i, shownOnes) {
  const step = frame.time.step, end = frame.horizon * step;
  const ones = shownOnes.filter((one) => one.meaningful || !signal.state);
  const bounds = [signal.lower, signal.upper].map((bound) => (bound.length > 1 ? bound : Array(frame.horizon + 1).fill(bound[0])));
  /* a replay that runs away does not squeeze the others into a line */
  const calm = ones.filter((one) => one.name !== "filtered"), others = ones.filter((one) => one.name === "filtered");
  const near = (calm.length ? others : []).flatMap((one) => one.signals[i]);
  const y = range((calm.length ? calm : ones).flatMap((one) => one.signals[i]), [...signal.lower, ...signal.upper], near);
  const curves = bounds.map((bound) => ({ kind: "bound", points: bound.map((value, t) => [t * step, value]) }));
  for (const one of ones) {
    const points = one.signals[i].map((value, t) => [t * step, value]);
    curves.push({ kind: one.name, points: signal.state ? points : stairs(points, step) });
  }
  const own = ones.find((one) => one.name === "constrained"), sizes = own ? own.signals[i].filter((value) => value !== null) : [];
  const words = sizes.length ? `from ${shown(Math.min(...sizes))} to ${shown(Math.max(...sizes))}` : "no solution";
  const limits = `bounds ${shown(signal.lower[0])} and ${shown(signal.upper[0])}`;
  return {
    title: signal.name, wide: alone(frame) && !signal.state, x: [0, end], y, curves, xLabel: frame.time.label,
    words: `${signal.name} over time: ${words}; ${limits}; shown: ${listed(ones.map((one) => one.name))}`,
  };
}

/* A single control has panels over the whole width. */
const alone = (frame) => frame.signals.filter((signal) => !signal.state).length === 1;

/* A control is held between two times. */
function stairs(points, step) {
  return points.flatMap(([x, y]) => [[x, y], [x + step, y]]);
}

function spectrumPanel(frame, spectrum, i, shownOnes) {
  const ones = shownOnes.filter((one) => one.meaningful || i < frame.signals.filter((signal) => !signal.state).length);
  const log = (value) => (value === null ? null : value > 0 ? Math.log10(value) : -30);
  const all = ones.map((one) => one.spectra[i].map(log));
  const peak = Math.max(...all.flat(), ...spectrum.limits.flatMap((limit) => limit.values.map(log)), -29);
  const high = peak > -29 ? Math.ceil(peak + 0.1) : 0, low = Math.max(high - DECADES, -30);
  const curves = spectrum.limits.map((limit) => ({ kind: "limit", points: limit.at.map((x, k) => [x, log(limit.values[k])]) }));
  ones.forEach((one, k) => curves.push({ kind: one.name, points: all[k].map((value, bin) => [bin * spectrum.step, value]) }));
  const bands = spectrum.stopped.map(([from, to]) => `${shown(from)} to ${shown(to)}`);
  const last = ((ones[0] ? ones[0].spectra[i].length : 2) - 1) * spectrum.step;
  const right = ones.length ? last : Math.max(...spectrum.stopped.flat(), spectrum.step);
  return {
    title: `spectrum: ${spectrum.label}`, wide: alone(frame), log: true, stopped: spectrum.stopped, x: [0, right], y: [low, high], curves,
    xLabel: frame.frequency.label,
    words: `magnitude of the spectrum of ${spectrum.name}, logarithmic; ${bands.length ? `stopped or limited: ${listed(bands)}` : "no stopped band"}; shown: ${listed(ones.map((one) => one.name))}`,
  };
}

/* What is left ringing over the natural frequency: the limit holds within the box. */
function vibrationPanel(frame, vibration, i, shownOnes) {
  const curves = [{ kind: "limit", points: vibration.box.map((x) => [x, vibration.limit]) }];
  for (const one of shownOnes) curves.push({ kind: one.name, points: one.vibrations[i].map((value, k) => [vibration.at[k], value]) });
  return {
    title: vibration.name, wide: alone(frame), stopped: [vibration.box], x: [vibration.at[0], vibration.at.at(-1)], y: [0, vibration.top], curves,
    xLabel: "natural frequency [Hz]",
    words: `${vibration.name} over the natural frequency; limit ${shown(vibration.limit)} from ${vibration.box.map((x) => shown(x)).join(" to ")} Hz; shown: ${listed(shownOnes.map((one) => one.name))}`,
  };
}

for (const slider of sliders.values()) addSlider(slider);
for (const kind of KINDS) byId(`show-${kind}`).addEventListener("change", drawAll);
for (const kind of ["classical", "filtered"]) byId(`show-${kind}`).parentElement.hidden = true;
byId("reset").addEventListener("click", () => setAll(Object.fromEntries([...sliders.values()].map((slider) => [slider.key, slider.own]))));
byId("controls").addEventListener("submit", (event) => event.preventDefault());
let resizing = 0;
addEventListener("resize", () => {
  cancelAnimationFrame(resizing);
  resizing = requestAnimationFrame(() => answer && drawAll());
});
moved();
