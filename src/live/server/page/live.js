// The page: receives the stream of events and passes each on to the part that shows it.

import { Charts } from "./charts.js";
import { Field } from "./field.js";
import { rough, showFigures } from "./figures.js";
import { Processes } from "./nodes.js";

const byId = (id) => document.getElementById(id);

// Removes the token from the address, so that nobody reads it on the screen or in the browser's history. A reloaded page
// finds it in the storage of its tab (refused.js).
const token = document.documentElement.dataset.token;
sessionStorage.setItem("rangehound-token", token);
history.replaceState(null, "", "/");

const RETRY_MS = 1000;
// A running run reports its processes at least once a second.
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
    setConnection("ended", reason);
    processes.end();
  },
};

// At most once per frame of the screen, and not while the page is hidden.
function draw() {
  if (isDrawing) return;
  isDrawing = true;
  requestAnimationFrame(() => {
    isDrawing = false;
    if (!about || !picture) return;
    const isMoving = field.draw();
    charts.draw(picture);
    showFigures(byId("figures"), picture, about);
    // Of a fast run only some ticks are read.
    const { ticks } = picture.counts;
    byId("about").textContent = ticks < picture.tick ? `${about.text}; counts are of ${rough(ticks)} ticks` : about.text;
    byId("progress").firstElementChild.style.width = `${(100 * picture.tick) / Math.max(about.ticks, 1)}%`;
    // For tests: the number of drawn pictures, and the time of the first.
    const drawn = document.documentElement.dataset;
    drawn.pictures = Number(drawn.pictures ?? 0) + 1;
    drawn.firstMs ??= String(Math.round(performance.timeOrigin + performance.now()));
    if (isMoving) draw();
  });
}

function setConnection(state, text) {
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
      if (!isEnded) setConnection("live", "live");
      listen(JSON.parse(event.data));
      if (isEnded) stream.close();
    });
  }
  // The browser stops retrying after an answer that is not a stream; this code continues.
  stream.addEventListener("error", () => {
    stream.close();
    if (isEnded) return;
    setConnection("lost", "connection lost, trying again");
    setTimeout(open, RETRY_MS);
  });
}

setInterval(() => {
  const quietMs = performance.now() - newsAt;
  const isOpen = byId("connection").dataset.state === "live" || byId("connection").dataset.state === "quiet";
  if (isOpen && !isEnded && about?.what === "run" && quietMs > QUIET_MS) setConnection("quiet", `no news for ${Math.round(quietMs / 1000)} s`);
}, 1000);

addEventListener("resize", draw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
field.view.onChange = draw;
open();
