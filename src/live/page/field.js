// The field from above: who is where, what they know of the target and where they are told to go.

import { clear, colour } from "./charts.js";
import { number } from "./figures.js";

const SIGMAS = 3;
// Teams up to this size have circles, arrows and names that can be told apart.
const FEW = 16;
// Around all that is shown, as a part of it.
const MARGIN = 0.12;
const SMALLEST_M = 1;

export class Field {
  constructor(canvas, fit, legend) {
    Object.assign(this, { canvas, fit, legend });
    this.trails = [];
    this.down = new Map();
    this.picture = null;
    // Centre in m, and m per pixel. The user's own view stays until all is asked for again.
    this.view = null;
    this.isOwn = false;
    this.onChange = () => {};
    this.listen();
  }

  begin(about) {
    this.about = about;
    this.trails = [];
    this.view = this.isOwn ? this.view : null;
    const shape = (body) => `<svg viewBox="0 0 26 16" aria-hidden="true">${body}</svg>`;
    const first = about.robot_colours[0];
    this.legend.innerHTML = [
      [shape(`<circle cx="13" cy="8" r="5.5" fill="currentColor"/>`), "target"],
      [shape(`<ellipse cx="13" cy="8" rx="11" ry="6" fill="${about.estimate_colour}33" stroke="${about.estimate_colour}" stroke-width="2"/>`), "estimate, 3 sigma"],
      [shape(`<path d="M6 2L21 8L6 14Z" fill="${first}"/>`), "robot"],
      [shape(`<circle cx="13" cy="22" r="18" fill="none" stroke="${first}" stroke-width="1.5"/>`), "its range"],
      [shape(`<path fill="none" stroke="currentColor" stroke-width="2" d="M2 8H23M17 3L23 8L17 13"/>`), "commanded heading"],
    ].map(([picture, name]) => `<li>${picture}${name}</li>`).join("");
  }

  show(picture) {
    this.picture = picture;
    const { tick, target_m, estimate_m } = picture;
    const last = this.trails.at(-1);
    // A run that was resumed or shown anew may go back.
    if (last && last.tick > tick) this.trails = [];
    if (last?.tick === tick) return;
    this.trails.push({ tick, target_m, estimate_m, robots_m: picture.robots.map((robot) => robot.position_m) });
    while (this.trails.length > this.about.trail_max) this.trails.shift();
  }

  // Draws, and says whether the view is still on its way.
  draw() {
    const { context, width, height } = clear(this.canvas);
    const isMoving = this.follow(width, height);
    const { x, y, scale } = this.view;
    const at = ([x_m, y_m]) => [width / 2 + (x_m - x) / scale, height / 2 - (y_m - y) / scale];
    this.drawGrid(context, width, height);
    const few = this.picture.robots.length <= FEW;
    this.drawTrails(context, at, few);
    this.drawRanges(context, at, few);
    this.drawEstimate(context, at, scale);
    this.drawRobots(context, at, few);
    this.drawLens(context, width, height, at);
    return isMoving;
  }

  // A closer look at the target, in the corner that is farthest from it, where its ellipse is too small to be seen.
  drawLens(context, width, height, at) {
    const { covariance_m2: [xx, , yy], estimate_m } = this.picture;
    const spread_m = SIGMAS * Math.sqrt(Math.max(xx, yy, 0));
    const radius = Math.min(width, height) * 0.15;
    if (!(spread_m > 0) || spread_m / this.view.scale > radius * 0.5) return;
    const [px, py] = at(estimate_m);
    const [left, top] = [px > width / 2, py > height / 2];
    const [x, y] = [left ? radius + 30 : width - radius - 12, top ? radius + 12 : height - radius - 24];
    // Steps, so that the scale can be read and does not flicker.
    const step_m = niceStep(spread_m);
    const scale = (1.6 * step_m) / radius;
    const lens = ([x_m, y_m]) => [x + (x_m - estimate_m[0]) / scale, y - (y_m - estimate_m[1]) / scale];
    context.save();
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    context.fillStyle = colour("--card");
    context.fill();
    context.clip();
    this.drawTrails(context, lens, true);
    this.drawRanges(context, lens, this.picture.robots.length <= FEW, scale);
    this.drawEstimate(context, lens, scale);
    context.restore();
    context.strokeStyle = colour("--quiet");
    context.lineWidth = 1;
    context.beginPath();
    context.arc(x, y, radius, 0, 2 * Math.PI);
    const bar = step_m / scale;
    context.moveTo(x - bar / 2, y + radius - 12);
    context.lineTo(x + bar / 2, y + radius - 12);
    context.stroke();
    context.fillStyle = colour("--quiet");
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText(`${number(step_m)} m`, x, y + radius - 16);
    context.textAlign = "left";
  }

  robotColour(id) {
    const colours = this.about.robot_colours;
    return colours[id % colours.length];
  }

  // Moves the view so that all is in it: out at once, in slowly, as the picture shall not shake.
  follow(width, height) {
    if (this.isOwn && this.view) return false;
    const { covariance_m2: [xx, , yy], estimate_m, target_m, robots } = this.picture;
    const spread = [SIGMAS * Math.sqrt(Math.max(xx, 0)), SIGMAS * Math.sqrt(Math.max(yy, 0))];
    const places = [target_m ?? estimate_m, ...robots.map((robot) => robot.position_m)];
    places.push(...this.recent(places));
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
      this.view ??= { x: 0, y: 0, scale: 0.1 };
      return false;
    }
    const now = this.view;
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (!now || still) {
      this.view = goal;
      return false;
    }
    const step = goal.scale > now.scale ? 0.25 : 0.06;
    for (const key of ["x", "y", "scale"]) now[key] += step * (goal[key] - now[key]);
    return Math.abs(goal.scale / now.scale - 1) > 0.01 || Math.hypot(goal.x - now.x, goal.y - now.y) > now.scale;
  }

  // Where they have come from, as far as it does not make them small.
  recent(places) {
    const extent = (some) => Math.max(...[0, 1].map((axis) => Math.max(...some.map((p) => p[axis])) - Math.min(...some.map((p) => p[axis]))));
    const most = 2.5 * Math.max(extent(places), 10 * SMALLEST_M);
    const far = [0.5, 0.25, 0.12, 0.06, 0.03].map((part) => this.trails.at(-Math.ceil(part * this.trails.length)));
    const all = far.filter(Boolean).map((trail) => [trail.estimate_m, ...trail.robots_m]);
    return all.find((trail) => extent([...places, ...trail]) <= most) ?? [];
  }

  drawGrid(context, width, height) {
    const { x, y, scale } = this.view;
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
    context.beginPath();
    for (const x_m of lines(x, width)) {
      const px = Math.round(width / 2 + (x_m - x) / scale) + 0.5;
      context.moveTo(px, 0);
      context.lineTo(px, height);
      context.fillText(x_m.toFixed(digits), px + 3, height - 4);
    }
    for (const y_m of lines(y, height)) {
      const py = Math.round(height / 2 - (y_m - y) / scale) + 0.5;
      context.moveTo(0, py);
      context.lineTo(width, py);
      // Not into the corner, where the unit is.
      if (py > 24 && py < height - 16) context.fillText(y_m.toFixed(digits), 3, py - 3);
    }
    context.stroke();
    context.fillText("m", 3, 12);
  }

  drawTrails(context, at, few) {
    const path = (place, stroke, width, alpha) => {
      context.globalAlpha = alpha;
      context.strokeStyle = stroke;
      context.lineWidth = width;
      context.beginPath();
      for (const places of this.trails) {
        const point = place(places);
        if (point) context.lineTo(...at(point));
      }
      context.stroke();
    };
    this.picture.robots.forEach((_, id) => path((places) => places.robots_m[id], this.robotColour(id), 1.5, few ? 0.6 : 0.25));
    path((places) => places.estimate_m, this.about.estimate_colour, 1.5, 0.7);
    path((places) => places.target_m, colour("--ink"), 2, 0.7);
    context.globalAlpha = 1;
  }

  drawRanges(context, at, few, scale = this.view.scale) {
    context.lineWidth = 1;
    context.globalAlpha = few ? 0.4 : Math.max(0.06, 3 / this.picture.robots.length);
    this.picture.robots.forEach(({ range_m, range_from_m }, id) => {
      // A negative range, which noise can make, has no circle.
      if (!range_from_m || !(range_m > 0)) return;
      context.strokeStyle = this.robotColour(id);
      context.beginPath();
      context.arc(...at(range_from_m), range_m / scale, 0, 2 * Math.PI);
      context.stroke();
    });
    context.globalAlpha = 1;
  }

  drawEstimate(context, at, scale) {
    const { estimate_m, target_m, covariance_m2: [xx, xy, yy] } = this.picture;
    const [px, py] = at(estimate_m);
    // Half axes and direction of a 2 x 2 covariance in closed form.
    const mean = (xx + yy) / 2;
    const root = Math.hypot((xx - yy) / 2, xy);
    const axis = (variance) => Math.min(1e6, (SIGMAS * Math.sqrt(Math.max(variance, 0))) / scale);
    const stroke = this.about.estimate_colour;
    context.strokeStyle = stroke;
    context.lineWidth = 2;
    context.fillStyle = `${stroke}26`;
    context.beginPath();
    // Pixels count downwards, so the angle turns round.
    context.ellipse(px, py, axis(mean + root), axis(mean - root), -0.5 * Math.atan2(2 * xy, xx - yy), 0, 2 * Math.PI);
    context.fill();
    context.stroke();
    context.beginPath();
    context.moveTo(px - 6, py);
    context.lineTo(px + 6, py);
    context.moveTo(px, py - 6);
    context.lineTo(px, py + 6);
    context.stroke();
    if (!target_m) return;
    context.fillStyle = colour("--ink");
    context.beginPath();
    context.arc(...at(target_m), 5, 0, 2 * Math.PI);
    context.fill();
  }

  drawRobots(context, at, few) {
    const size = few ? 10 : 6;
    context.font = "600 12px system-ui, sans-serif";
    this.picture.robots.forEach((robot, id) => {
      const [px, py] = at(robot.position_m);
      const fill = this.robotColour(id);
      if (few && robot.command_mps > 0) arrow(context, px, py, robot.command_rad, 2.8 * size);
      const down = this.down.get(`robot-${id}`);
      context.save();
      context.translate(px, py);
      context.rotate(-robot.heading_rad);
      context.beginPath();
      context.moveTo(size, 0);
      context.lineTo(-0.8 * size, 0.75 * size);
      context.lineTo(-0.8 * size, -0.75 * size);
      context.closePath();
      context.fillStyle = down ? colour("--card") : fill;
      context.strokeStyle = down ? fill : colour("--card");
      context.lineWidth = down ? 2 : 1;
      context.fill();
      context.stroke();
      context.restore();
      if (robot.is_distrusted) {
        context.strokeStyle = colour("--bad");
        context.setLineDash([3, 3]);
        context.beginPath();
        context.arc(px, py, 1.7 * size, 0, 2 * Math.PI);
        context.stroke();
        context.setLineDash([]);
      }
      const name = [few ? id : null, down, robot.is_distrusted ? "distrusted" : null].filter((part) => part != null && part !== "").join(" ");
      if (name !== "") {
        context.fillStyle = down || robot.is_distrusted ? colour("--bad") : colour("--text");
        context.fillText(name, px + size + 3, py + size + 5);
      }
    });
  }

  // Wheel, mouse and keys look closer or elsewhere. Fingers move the page, as they do everywhere.
  listen() {
    const { canvas } = this;
    const own = (change) => {
      if (!this.view) return;
      this.isOwn = true;
      this.fit.hidden = false;
      change(this.view);
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

function arrow(context, px, py, heading_rad, length) {
  const [dx, dy] = [Math.cos(heading_rad), -Math.sin(heading_rad)];
  const [ex, ey] = [px + length * dx, py + length * dy];
  context.strokeStyle = colour("--quiet");
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(px, py);
  context.lineTo(ex, ey);
  context.lineTo(ex - 6 * dx + 3.5 * dy, ey - 6 * dy - 3.5 * dx);
  context.moveTo(ex, ey);
  context.lineTo(ex - 6 * dx - 3.5 * dy, ey - 6 * dy + 3.5 * dx);
  context.stroke();
}

// 1, 2 or 5 times a power of ten, from this on.
export function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= least);
}
