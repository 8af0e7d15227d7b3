// Curves over the whole run. The server thins them to some hundred points.

import { axisNumber, metres, micros, niceStep, number } from "./figures.js";

// Indices in a point, as the server's history.rs writes it.
const [TIME, ERROR, TRACE, NIS, NIS_LOW, NIS_HIGH, LATENCY, LATENCY_MAX, LEAST_NEXT] = [1, 2, 3, 4, 5, 6, 7, 8, 9];

const BAND_OPACITY = 0.18;

const sigma = (times) => (point) => (point[TRACE] == null ? null : times * Math.sqrt(Math.max(point[TRACE], 0)));

// The charts: a band between two curves, and lines, each with name and colour; `after_s` shifts a line in time.
// `of` formats the newest value.
function allCharts(about) {
  const ink = "--ink";
  const estimate = about.estimate_colour;
  return [
    {
      name: "Position error", unit: "m", isLog: true,
      band: { low: () => null, high: sigma(3), colour: estimate, name: "to 3 sigma" },
      lines: [{ value: sigma(1), colour: estimate, name: "sigma" }, { value: (p) => p[ERROR], colour: ink, name: "error" }],
      of: (p) => (p[ERROR] == null ? `sigma ${metres(sigma(1)(p))}` : `${metres(p[ERROR])}, sigma ${metres(sigma(1)(p))}`),
    },
    {
      name: "Position trace", unit: "m²", isLog: true,
      // The planner's bound is for the next tick; the trace mostly equals it.
      lines: [
        { value: (p) => p[TRACE], colour: estimate, name: "trace", width: 2.5 },
        { value: (p) => p[LEAST_NEXT], after_s: about.dt_s, colour: ink, name: "proven lower bound", width: 1 },
      ],
      of: (p) => `${number(p[TRACE])} m²`,
    },
    {
      name: "NIS", unit: "", isLog: false,
      band: { low: (p) => p[NIS_LOW], high: (p) => p[NIS_HIGH], colour: "--quiet", name: "95 %" },
      lines: [{ value: () => 1, colour: "--quiet", width: 1 }, { value: (p) => p[NIS], colour: about.robot_colours[0], name: "NIS" }],
      of: (p) => `${number(p[NIS])} for each ${about.measured.replace(/s$/, "")}, 1 is ideal`,
    },
    {
      name: "Range to heading", unit: "µs", isLog: true,
      lines: [
        { value: (p) => p[LATENCY_MAX], colour: about.robot_colours[5], name: "slowest robot", width: 1 },
        { value: (p) => p[LATENCY], colour: about.robot_colours[0], name: "middle robot" },
      ],
      of: (p) => `${micros(p[LATENCY])} to ${micros(p[LATENCY_MAX])}`,
    },
  ];
}

export class Charts {
  constructor(place) {
    this.place = place;
    this.points = [];
    this.charts = [];
  }

  begin(about) {
    this.points = [];
    this.place.replaceChildren();
    this.charts = allCharts(about).map((chart) => {
      const figure = document.createElement("figure");
      figure.innerHTML = `<figcaption><b></b><ul></ul><span></span></figcaption><canvas role="img"></canvas>`;
      figure.querySelector("b").textContent = chart.name;
      const key = [...chart.lines, ...(chart.band ? [{ ...chart.band, value: chart.band.high, width: 8 }] : [])].filter((entry) => entry.name);
      for (const entry of key) entry.item = keyItem(entry);
      figure.querySelector("ul").append(...key.map((entry) => entry.item));
      this.place.append(figure);
      return { ...chart, key, now: figure.querySelector("span"), canvas: figure.querySelector("canvas") };
    });
  }

  // The new points replace all from an index on.
  add({ from, points }) {
    this.points.length = Math.min(this.points.length, from);
    this.points.push(...points);
  }

  draw() {
    const newest = this.points.at(-1);
    if (!newest) return;
    for (const chart of this.charts) {
      const text = chart.of(newest);
      chart.now.textContent = text;
      // Unknown quantities have no entry.
      for (const { item, value } of chart.key) item.hidden = !this.points.some((point) => value(point) != null);
      chart.canvas.setAttribute("aria-label", `${chart.name} over time: ${text}`);
      drawChart(chart, this.points);
    }
  }
}

// A legend entry: a name beside its line or band.
function keyItem({ name, colour, width = 1.75, high }) {
  const item = document.createElement("li");
  const line = document.createElement("i");
  const known = colour.startsWith("--") ? `var(${colour})` : colour;
  Object.assign(line.style, { borderTopWidth: `${width}px`, borderTopColor: known, opacity: high ? BAND_OPACITY : 1 });
  item.append(line, name);
  return item;
}

function drawChart({ canvas, band, lines, isLog, unit }, points) {
  const { context, width, height } = clear(canvas);
  const [left, right, top, bottom] = [40, width - 6, 6, height - 16];
  const limits = limitsOf(points, band, lines, isLog);
  if (!limits) return;
  const [low, high] = limits;
  const [begin, end] = [points[0][TIME], points.at(-1)[TIME]];
  const x = (time_s) => left + ((time_s - begin) / Math.max(end - begin, 1e-9)) * (right - left);
  const place = (value) => (isLog ? Math.log(Math.max(value, low * 1e-3)) : value);
  const y = (value) => bottom - ((place(value) - place(low)) / (place(high) - place(low))) * (bottom - top);
  drawAxes(context, { left, right, top, bottom, x, y, begin, end, low, high, isLog, unit });
  context.save();
  context.beginPath();
  context.rect(left, top, right - left, bottom - top);
  context.clip();
  if (band) {
    const inside = points.filter((point) => band.high(point) != null);
    context.globalAlpha = BAND_OPACITY;
    context.fillStyle = colour(band.colour);
    context.beginPath();
    for (const point of inside) context.lineTo(x(point[TIME]), y(band.high(point)));
    for (const point of inside.toReversed()) context.lineTo(x(point[TIME]), band.low(point) == null ? bottom : y(band.low(point)));
    context.fill();
    context.globalAlpha = 1;
  }
  for (const line of lines) {
    context.strokeStyle = colour(line.colour);
    context.lineWidth = line.width ?? 1.75;
    context.lineJoin = "round";
    context.beginPath();
    let isOn = false;
    for (const point of points) {
      const value = line.value(point);
      // Missing values leave a gap.
      if (value == null) { isOn = false; continue; }
      context[isOn ? "lineTo" : "moveTo"](x(point[TIME] + (line.after_s ?? 0)), y(value));
      isOn = true;
    }
    context.stroke();
  }
  context.restore();
}

// The limit of the axis: a poor start or a short loss must not hide the rest.
function limitsOf(points, band, lines, isLog) {
  const curves = [...lines.map((line) => line.value), ...(band ? [band.low, band.high] : [])];
  const values = curves.flatMap((curve) => points.map(curve)).filter((value) => Number.isFinite(value) && (!isLog || value > 0));
  if (values.length === 0) return null;
  values.sort((a, b) => a - b);
  const at = (part) => values[Math.round(part * (values.length - 1))];
  if (isLog) return [Math.max(at(0.002), at(0.5) * 1e-4) / 1.15, Math.max(at(1), at(0) * 2) * 1.15];
  const high = Math.min(at(1), 2.5 * at(0.97));
  return [Math.min(0, at(0)), high > 0 ? 1.08 * high : 1];
}

function drawAxes(context, { left, right, top, bottom, x, y, begin, end, low, high, isLog, unit }) {
  context.strokeStyle = colour("--grid");
  context.fillStyle = colour("--quiet");
  context.lineWidth = 1;
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "right";
  context.beginPath();
  for (const value of isLog ? logTicks(low, high) : linearTicks(low, high)) {
    const py = Math.round(y(value)) + 0.5;
    context.moveTo(left, py);
    context.lineTo(right, py);
    context.fillText(axisNumber(value), left - 4, py + 4);
  }
  context.textAlign = "center";
  const step = niceStep(Math.max((end - begin) / 4, 1e-3));
  for (let time_s = Math.ceil(begin / step) * step; time_s <= end + 1e-9; time_s += step) {
    context.moveTo(x(time_s), bottom);
    context.lineTo(x(time_s), bottom + 3);
    // No label at the place of the unit.
    if (x(time_s) < right - 22) context.fillText(axisNumber(time_s), x(time_s), bottom + 14);
  }
  context.rect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
  context.stroke();
  context.textAlign = "right";
  context.fillText("s", right, bottom + 14);
  context.textAlign = "left";
  if (unit) context.fillText(unit, left + 4, top + 12);
}

function linearTicks(low, high) {
  const step = niceStep((high - low) / 4);
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.floor(high / step) - first + 1 }, (_, index) => (first + index) * step);
}

// Powers of ten, and 2 and 5 times these if there is room.
function logTicks(low, high) {
  const decades = Math.log10(high / low);
  const factors = decades > 3 ? [1] : decades > 1.3 ? [1, 3] : [1, 2, 5];
  const ticks = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += Math.max(1, Math.ceil(decades / 6))) {
    ticks.push(...factors.map((factor) => factor * 10 ** power).filter((value) => value >= low && value <= high));
  }
  return ticks;
}

// The colour of a variable in style.css, which differs between light and dark, or the colour itself.
export function colour(name) {
  return name.startsWith("--") ? getComputedStyle(document.documentElement).getPropertyValue(name).trim() : name;
}

// An empty canvas with the pixels of the screen.
export function clear(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = devicePixelRatio || 1;
  const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return { context, width, height };
}
