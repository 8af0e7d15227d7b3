// The field from above: positions, the estimate of the target, and the commanded headings.

import { clear, colour } from "./charts.js";
import { niceStep, number } from "./figures.js";
import { SIGMAS, View } from "./view.js";

// Teams up to this size have circles, arrows and names.
const FEW = 16;

export class Field {
  constructor(canvas, fit, legend) {
    Object.assign(this, { canvas, legend });
    this.view = new View(canvas, fit);
    this.trails = [];
    this.down = new Map();
    this.picture = null;
  }

  begin(about) {
    this.about = about;
    this.trails = [];
    this.view.begin();
    const shape = (body) => `<svg viewBox="0 0 26 16" aria-hidden="true">${body}</svg>`;
    const first = about.robot_colours[0];
    this.shown = new Set();
    // The last of an entry is its name in `shown`: until there is such a thing, the entry is hidden.
    this.legend.innerHTML = [
      [shape(`<circle cx="13" cy="8" r="5.5" fill="currentColor"/>`), "target"],
      [shape(`<ellipse cx="13" cy="8" rx="11" ry="6" fill="${about.estimate_colour}33" stroke="${about.estimate_colour}" stroke-width="2"/>`), "estimate, 3 sigma"],
      [shape(`<path d="M6 2L21 8L6 14Z" fill="${first}"/>`), "robot"],
      [shape(`<circle cx="13" cy="22" r="18" fill="none" stroke="${first}" stroke-width="1.5"/>`), "its range", "range"],
      [shape(`<path fill="none" stroke="${first}" stroke-width="1.5" d="M2 14L24 2"/>`), "its bearing", "bearing"],
      [shape(`<path fill="none" stroke="${first}" stroke-width="1.5" d="M1 13L14 8"/><ellipse cx="14" cy="8" rx="11" ry="6.5" fill="none" stroke="${first}" stroke-width="1.5"/>`), "where it believes it is, 3 sigma", "believed"],
      [shape(`<path fill="none" stroke="currentColor" stroke-width="2" d="M2 8H23M17 3L23 8L17 13"/>`), "commanded heading"],
    ].map(([picture, name, thing]) => `<li${thing ? ` data-thing="${thing}" hidden` : ""}>${picture}${name}</li>`).join("");
  }

  show(picture) {
    this.picture = picture;
    const { tick, target_m, estimate_m } = picture;
    const last = this.trails.at(-1);
    // A resumed or repeated run may go back in ticks.
    if (last && last.tick > tick) this.trails = [];
    if (last?.tick === tick) return;
    this.trails.push({ tick, target_m, estimate_m, robots_m: picture.robots.map((robot) => robot.position_m) });
    while (this.trails.length > this.about.trail_max) this.trails.shift();
  }

  // Draws; returns true while the view is still moving.
  draw() {
    const { context, width, height } = clear(this.canvas);
    const isMoving = this.view.follow(width, height, this.picture, this.trails);
    const { scale } = this.view.place;
    const at = this.view.at(width, height);
    this.view.drawGrid(context, width, height);
    const few = this.picture.robots.length <= FEW;
    this.drawTrails(context, at, few);
    this.drawRanges(context, at, few);
    this.drawBearings(context, at, few);
    this.drawEstimate(context, at, scale);
    this.drawBeliefs(context, at, few);
    this.drawRobots(context, at, few);
    this.drawLens(context, width, height, at);
    return isMoving;
  }

  // The corner of the four that hides the fewest robots and is farthest from the target.
  corner(width, height, radius, at) {
    const [low, high] = [radius + 30, radius + 12];
    const corners = [[width - high, high], [width - high, height - low], [low, high], [low, height - low]];
    const hidden = (corner, place) => Math.hypot(at(place)[0] - corner[0], at(place)[1] - corner[1]) < radius + 15;
    const worth = (corner) => {
      const robots = this.picture.robots.filter((robot) => hidden(corner, robot.position_m)).length;
      const [px, py] = at(this.picture.estimate_m);
      // Keeps its place unless another is clearly better.
      const bonus = corner.join() === this.lastCorner ? 0.2 : 0;
      return Math.hypot(px - corner[0], py - corner[1]) / Math.hypot(width, height) - robots + bonus;
    };
    const best = corners.reduce((best, corner) => (worth(corner) > worth(best) ? corner : best));
    this.lastCorner = best.join();
    return best;
  }

  // An enlarged view of the target, if its ellipse is too small to be seen.
  drawLens(context, width, height, at) {
    const { covariance_m2: [xx, , yy], estimate_m } = this.picture;
    const spread_m = SIGMAS * Math.sqrt(Math.max(xx, yy, 0));
    const radius = Math.min(width, height) * 0.15;
    if (!(spread_m > 0) || spread_m / this.view.place.scale > radius * 0.5) return;
    const [x, y] = this.corner(width, height, radius, at);
    // In steps, so that the scale is readable and does not flicker.
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
    const few = this.picture.robots.length <= FEW;
    this.drawRanges(context, lens, few, scale);
    this.drawBearings(context, lens, few);
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

  // Draws with thin lines in the colour of each robot, paler for a large team. `draw` is true if it drew the named thing.
  drawOfRobots(context, few, thing, draw, strength = 1) {
    context.lineWidth = 1;
    context.globalAlpha = strength * (few ? 0.4 : Math.max(0.06, 3 / this.picture.robots.length));
    this.picture.robots.forEach((robot, id) => {
      context.strokeStyle = this.robotColour(id);
      context.beginPath();
      if (!draw(robot)) return;
      context.stroke();
      if (this.shown.has(thing)) return;
      this.shown.add(thing);
      this.legend.querySelector(`[data-thing="${thing}"]`).hidden = false;
    });
    context.globalAlpha = 1;
  }

  drawRanges(context, at, few, scale = this.view.place.scale) {
    this.drawOfRobots(context, few, "range", ({ range_m, believed_m }) => {
      // Noise can make a range negative: it has no circle.
      if (!believed_m || !(range_m > 0)) return false;
      context.arc(...at(believed_m), range_m / scale, 0, 2 * Math.PI);
      return true;
    });
  }

  // From where the robot believes it is to just behind the estimate, or as far as its sensor reaches.
  drawBearings(context, at, few) {
    this.drawOfRobots(context, few, "bearing", ({ believed_m, bearing_to_m }) => {
      if (!bearing_to_m) return false;
      context.moveTo(...at(believed_m));
      context.lineTo(...at(bearing_to_m));
      return true;
    });
  }

  // Where robots believe they are, with their own ellipses, and a line from where they are.
  drawBeliefs(context, at, few) {
    this.drawOfRobots(context, few, "believed", ({ position_m, believed_m, believed_covariance_m2 }) => {
      if (!believed_m || (!believed_covariance_m2 && position_m.join() === believed_m.join())) return false;
      if (believed_covariance_m2) addEllipse(context, at(believed_m), believed_covariance_m2, this.view.place.scale);
      context.moveTo(...at(position_m));
      context.lineTo(...at(believed_m));
      return true;
    }, 2);
  }

  drawEstimate(context, at, scale) {
    const { estimate_m, target_m, covariance_m2 } = this.picture;
    const [px, py] = at(estimate_m);
    const stroke = this.about.estimate_colour;
    context.strokeStyle = stroke;
    context.lineWidth = 2;
    context.fillStyle = `${stroke}26`;
    context.beginPath();
    addEllipse(context, [px, py], covariance_m2, scale);
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
      const name = [few ? (this.about.labels?.[id] ?? id) : null, down, robot.is_distrusted ? "distrusted" : null].filter((part) => part != null && part !== "").join(" ");
      if (name !== "") {
        context.fillStyle = down || robot.is_distrusted ? colour("--bad") : colour("--text");
        context.fillText(name, px + size + 3, py + size + 5);
      }
    });
  }
}

// Adds the ellipse of a 2 x 2 covariance round a place in pixels to a path.
function addEllipse(context, [px, py], [xx, xy, yy], scale) {
  // Half axes and direction in closed form.
  const mean = (xx + yy) / 2;
  const root = Math.hypot((xx - yy) / 2, xy);
  const axis = (variance) => Math.min(1e6, (SIGMAS * Math.sqrt(Math.max(variance, 0))) / scale);
  // Pixels count downwards, so the angle changes its sign.
  context.ellipse(px, py, axis(mean + root), axis(mean - root), -0.5 * Math.atan2(2 * xy, xx - yy), 0, 2 * Math.PI);
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
