// The page: takes the stream of events and hands each to who shows it.

import { Charts } from "./charts.js";
import { Field } from "./field.js";
import { rough, showFigures } from "./figures.js";
import { Processes } from "./nodes.js";

const byId = (id) => document.getElementById(id);

// The token goes out of sight: nobody reads it from a screen or finds it in the browser's history. A page that is
// loaded again finds it in this tab's own storage (refused.js).
const token = document.documentElement.dataset.token;
sessionStorage.setItem("rangehound-token", token);
history.replaceState(null, "", "/");

const RETRY_MS = 1000;
// A run that goes on tells of its processes once a second at the least.
const QUIET_MS = 4000;

const field = new Field(byId("field"), byId("fit"), byId("legend"));
const charts = new Charts(byId("charts"));
const processes = new Processes(byId("processes"), token);

let about = null;
let picture = null;
let newsAt = performance.now();
let isEnded = false;
let isDrawing = false;

const listeners = {
  about(data) {
    about = data;
    document.title = `${data.name}: rangehound live`;
    byId("title").textContent = `${data.what} ${data.name}`;
    const team = data.robots === 1 ? "1 robot" : `${data.robots} robots`;
    about.text = `${data.scenario}: ${team}, ${data.planner} planner, ${data.clock === "lockstep" ? "lock step" : "real time"}`;
    byId("about").textContent = about.text;
    field.begin(data);
    charts.begin(data);
    processes.begin(data);
  },
  trails(data) {
    field.trails = data;
  },
  picture(data) {
    picture = data;
    charts.add(data.history);
    field.show(data);
    byId("waiting").hidden = true;
    draw();
  },
  nodes(data) {
    processes.show(data);
    field.down = processes.down();
    draw();
  },
  ended(reason) {
    isEnded = true;
    tell("ended", reason);
    processes.end();
  },
};

// At most once for each frame of the screen, and not at all while nobody sees it.
function draw() {
  if (isDrawing) return;
  isDrawing = true;
  requestAnimationFrame(() => {
    isDrawing = false;
    if (!about || !picture) return;
    const isMoving = field.draw();
    charts.draw(picture);
    showFigures(byId("figures"), picture, about);
    // A run that is faster than the eye is looked at in samples.
    const { ticks } = picture.tally;
    byId("about").textContent = ticks < picture.tick ? `${about.text}; counts are of ${rough(ticks)} ticks looked at` : about.text;
    byId("progress").firstElementChild.style.width = `${(100 * picture.tick) / Math.max(about.ticks, 1)}%`;
    // For tests and the curious: how many pictures have been drawn, and when the first was.
    const drawn = document.documentElement.dataset;
    drawn.pictures = Number(drawn.pictures ?? 0) + 1;
    drawn.firstMs ??= String(Math.round(performance.timeOrigin + performance.now()));
    if (isMoving) draw();
  });
}

function tell(state, text) {
  const connection = byId("connection");
  if (connection.textContent === text) return;
  connection.dataset.state = state;
  connection.textContent = text;
}

function open() {
  const stream = new EventSource(`/stream?token=${token}`);
  for (const [name, listen] of Object.entries(listeners)) {
    stream.addEventListener(name, (event) => {
      newsAt = performance.now();
      if (!isEnded) tell("live", "live");
      listen(JSON.parse(event.data));
      if (isEnded) stream.close();
    });
  }
  // The browser's own retries end at the first answer that is no stream; these go on.
  stream.addEventListener("error", () => {
    stream.close();
    if (isEnded) return;
    tell("lost", "connection lost, trying again");
    setTimeout(open, RETRY_MS);
  });
}

setInterval(() => {
  const quietMs = performance.now() - newsAt;
  const isOpen = byId("connection").dataset.state === "live" || byId("connection").dataset.state === "quiet";
  if (isOpen && !isEnded && about?.what === "run" && quietMs > QUIET_MS) tell("quiet", `no news for ${Math.round(quietMs / 1000)} s`);
}, 1000);

addEventListener("resize", draw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
field.view.onChange = draw;
open();
