// The visible part of the field: everything, or the part that the user chose.

import { colour } from "./charts.js";
import { niceStep } from "./figures.js";

// Size of the estimate's ellipse, in standard deviations.
export const SIGMAS = 3;
// Margin around everything, as a part of its size.
const MARGIN = 0.12;
const SMALLEST_M = 1;

export class View {
  constructor(canvas, fit) {
    Object.assign(this, { canvas, fit });
    // Centre in m, and m per pixel. A view that the user chose stays until "show all".
    this.place = null;
    this.isOwn = false;
    this.onChange = () => {};
    this.listen();
  }

  begin() {
    if (!this.isOwn) this.place = null;
  }

  // From m to pixels.
  at(width, height) {
    const { x, y, scale } = this.place;
    return ([x_m, y_m]) => [width / 2 + (x_m - x) / scale, height / 2 - (y_m - y) / scale];
  }

  // Moves the view so that it holds everything: outwards at once, inwards slowly, so that the picture does not shake.
  follow(width, height, picture, trails) {
    if (this.isOwn && this.place) return false;
    const { covariance_m2: [xx, , yy], estimate_m, target_m, robots } = picture;
    const spread = [SIGMAS * Math.sqrt(Math.max(xx, 0)), SIGMAS * Math.sqrt(Math.max(yy, 0))];
    const places = [target_m ?? estimate_m, ...robots.flatMap(({ position_m, believed_m }) => [position_m, believed_m ?? position_m])];
    places.push(...recent(places, trails));
    const bound = (axis) => {
      const values = places.map((place) => place[axis]).filter(Number.isFinite);
      const low = Math.min(...values, estimate_m[axis] - spread[axis]);
      const high = Math.max(...values, estimate_m[axis] + spread[axis]);
      return [low, high];
    };
    const [[left, right], [bottom, top]] = [bound(0), bound(1)];
    const room = 1 + 2 * MARGIN;
    const scale = Math.max(((right - left) * room) / width, ((top - bottom) * room) / height, SMALLEST_M / Math.min(width, height));
    const goal = { x: (left + right) / 2, y: (bottom + top) / 2, scale };
    if (!Object.values(goal).every(Number.isFinite)) {
      this.place ??= { x: 0, y: 0, scale: 0.1 };
      return false;
    }
    const now = this.place;
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (!now || still) {
      this.place = goal;
      return false;
    }
    const step = goal.scale > now.scale ? 0.25 : 0.06;
    for (const key of ["x", "y", "scale"]) now[key] += step * (goal[key] - now[key]);
    return Math.abs(goal.scale / now.scale - 1) > 0.01 || Math.hypot(goal.x - now.x, goal.y - now.y) > now.scale;
  }

  drawGrid(context, width, height) {
    const { x, y, scale } = this.place;
    const step = niceStep(scale * 90);
    context.strokeStyle = colour("--grid");
    context.fillStyle = colour("--quiet");
    context.lineWidth = 1;
    context.font = "11px system-ui, sans-serif";
    const digits = Math.max(0, -Math.floor(Math.log10(step)));
    const lines = (middle, pixels) => {
      const first = Math.ceil((middle - (pixels * scale) / 2) / step);
      const count = Math.min(60, Math.floor((pixels * scale) / step) + 1);
      return Array.from({ length: count }, (_, index) => (first + index) * step);
    };
    const labels = [];
    context.beginPath();
    for (const x_m of lines(x, width)) {
      const px = Math.round(width / 2 + (x_m - x) / scale) + 0.5;
      context.moveTo(px, 0);
      context.lineTo(px, height);
      labels.push([x_m.toFixed(digits), px + 3, height - 4]);
    }
    for (const y_m of lines(y, height)) {
      const py = Math.round(height / 2 - (y_m - y) / scale) + 0.5;
      context.moveTo(0, py);
      context.lineTo(width, py);
      // No label in the corner, where the unit is.
      if (py > 24 && py < height - 16) labels.push([y_m.toFixed(digits), 3, py - 3]);
    }
    context.stroke();
    labels.push(["m", 3, 12]);
    // With an outline in the background's colour, so that lines do not cross the text.
    context.strokeStyle = colour("--card");
    context.lineWidth = 4;
    context.lineJoin = "round";
    for (const label of labels) {
      context.strokeText(...label);
      context.fillText(...label);
    }
  }

  // Wheel, mouse and keys zoom and move the view. Touch scrolls the page, as usual.
  listen() {
    const { canvas } = this;
    const own = (change) => {
      if (!this.place) return;
      this.isOwn = true;
      this.fit.hidden = false;
      change(this.place);
      this.onChange();
    };
    const zoom = (factor, px, py) => own((view) => {
      const [dx, dy] = [px - canvas.clientWidth / 2, canvas.clientHeight / 2 - py];
      const scale = Math.min(1e4, Math.max(1e-4, view.scale * factor));
      view.x += dx * (view.scale - scale);
      view.y += dy * (view.scale - scale);
      view.scale = scale;
    });
    const move = (dx, dy) => own((view) => {
      view.x -= dx * view.scale;
      view.y += dy * view.scale;
    });
    const fit = () => {
      this.isOwn = false;
      this.fit.hidden = true;
      this.onChange();
    };
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      zoom(Math.exp(event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "touch") canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (canvas.hasPointerCapture(event.pointerId)) move(event.movementX, event.movementY);
    });
    canvas.addEventListener("dblclick", fit);
    this.fit.addEventListener("click", fit);
    const middle = () => [canvas.clientWidth / 2, canvas.clientHeight / 2];
    const keys = {
      "+": () => zoom(0.8, ...middle()), "=": () => zoom(0.8, ...middle()), "-": () => zoom(1.25, ...middle()), "0": fit,
      ArrowLeft: () => move(40, 0), ArrowRight: () => move(-40, 0), ArrowUp: () => move(0, 40), ArrowDown: () => move(0, -40),
    };
    canvas.addEventListener("keydown", (event) => {
      if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
      event.preventDefault();
      keys[event.key]();
    });
  }
}

// Trails, as far as they do not make the rest too small.
function recent(places, trails) {
  const extent = (some) => Math.max(...[0, 1].map((axis) => Math.max(...some.map((p) => p[axis])) - Math.min(...some.map((p) => p[axis]))));
  const most = 2.5 * Math.max(extent(places), 10 * SMALLEST_M);
  const far = [0.5, 0.25, 0.12, 0.06, 0.03].map((part) => trails.at(-Math.ceil(part * trails.length)));
  const all = far.filter(Boolean).map((trail) => [trail.estimate_m, ...trail.robots_m]);
  return all.find((trail) => extent([...places, ...trail]) <= most) ?? [];
}
