// The processes of the run, and the actions on them.

// A table of more processes shows only those that need attention.
const FEW = 14;

const SUPERVISOR = "run";

export class Processes {
  constructor(place, token) {
    this.token = token;
    this.place = place;
    this.body = place.querySelector("tbody");
    this.fold = place.querySelector("#fold");
    this.message = place.querySelector("#message");
    this.leads = place.querySelector("#leads");
    this.rows = new Map();
    this.nodes = [];
    this.isOpen = false;
    this.isEnded = false;
    this.fold.addEventListener("click", () => {
      this.isOpen = !this.isOpen;
      this.order();
    });
  }

  begin(about) {
    this.about = about;
    this.place.hidden = about.what !== "run";
  }

  show(status) {
    this.nodes = status.nodes;
    this.remote = new Set((status.gateway?.robots ?? []).map((remote) => `robot-${remote.robot}`));
    this.hasSupervisor = status.nodes.some((node) => node.name === SUPERVISOR && node.pid != null);
    const standbys = status.standbys ? `, ${status.standbys} standing by` : "";
    this.leads.textContent = status.nodes.every((node) => node.state === "ended") ? "" : status.leader == null ? (status.nodes.some((node) => node.name === "fusion" && node.state === "elsewhere") ? `fusion leads from another PID namespace${standbys}` : "nobody leads") : `fusion: process ${status.leader} leads${standbys}`;
    const names = new Set(this.nodes.map((node) => node.name));
    for (const [name, row] of this.rows) {
      if (!names.has(name)) {
        row.element.remove();
        this.rows.delete(name);
      }
    }
    this.nodes.forEach((node) => this.showRow(node));
    this.order();
  }

  // Robots that are not running: name and state.
  down() {
    return new Map(this.nodes.filter((node) => !isWell(node.state)).map((node) => [node.name, node.state]));
  }

  end() {
    this.isEnded = true;
    for (const row of this.rows.values()) Object.values(row.buttons).forEach((button) => (button.hidden = true));
  }

  showRow(node) {
    if (!this.rows.has(node.name)) this.rows.set(node.name, this.makeRow(node));
    const row = this.rows.get(node.name);
    const isNew = node.pid != null && row.pid != null && node.pid !== row.pid;
    const isWorse = row.state === "running" && !isWell(node.state);
    if (isNew) {
      row.was = row.pid;
      this.say(`${node.name} is back: process ${node.pid}, start ${node.starts}`);
    }
    if (isNew || isWorse) flash(row.element);
    row.pid = node.pid ?? row.pid;
    row.state = node.state;
    const isSupervisor = node.name === SUPERVISOR;
    const hasEnded = node.state === "ended";
    const isNone = isSupervisor && node.pid == null && !(hasEnded && row.pid != null);
    row.cells.state.textContent = row.cells.state.dataset.state = isNone ? "none" : node.state;
    row.element.classList.toggle("over", hasEnded);
    const before = row.was == null || hasEnded ? [] : [was(row.was), " "];
    row.cells.pid.replaceChildren(...before, node.pid ?? "–");
    row.cells.starts.textContent = node.starts;
    row.cells.silent.textContent = node.silent_s == null ? "–" : `${node.silent_s.toFixed(node.silent_s < 10 ? 2 : 0)} s`;
    row.cells.memory.textContent = node.resident_kb == null ? "–" : `${(node.resident_kb / 1024).toFixed(1)} MB`;
    const { kill, stop, restart } = row.buttons;
    const isThere = node.pid != null && node.state !== "gone" && !hasEnded && !isSupervisor && !this.isEnded;
    // On another host nothing can be stopped, and a service manager starts robots again.
    const isRemote = this.remote.has(node.name);
    kill.hidden = !isThere;
    stop.hidden = !isThere || isRemote;
    restart.hidden = !isThere || !(this.hasSupervisor || isRemote);
    const action = node.state === "stopped" ? "continue" : "stop";
    // One button for both actions keeps the keyboard's focus.
    label(stop, action, node.name);
  }

  makeRow(node) {
    const element = document.createElement("tr");
    element.dataset.node = node.name;
    const cells = {};
    for (const key of ["name", "state", "pid", "starts", "silent", "memory", "actions"]) {
      cells[key] = element.insertCell();
    }
    const id = Number(node.name.match(/^robot-(\d+)$/)?.[1] ?? NaN);
    if (!Number.isNaN(id)) {
      const swatch = document.createElement("span");
      swatch.className = "swatch";
      swatch.style.background = this.about.robot_colours[id % this.about.robot_colours.length];
      cells.name.append(swatch);
    }
    cells.name.append(node.name === SUPERVISOR ? "supervisor" : node.name);
    if (node.sensor != null) {
      // A name in a right-to-left script must not change the direction of the rest of the row.
      const sensor = document.createElement("bdi");
      sensor.textContent = `(${node.sensor})`;
      cells.name.append(" ", sensor);
    }
    cells.state.className = "state";
    cells.memory.className = "memory";
    const buttons = {};
    for (const action of node.name === SUPERVISOR ? [] : ["kill", "stop", "restart"]) {
      const button = document.createElement("button");
      button.type = "button";
      button.className = action;
      label(button, action, node.name);
      button.addEventListener("click", () => this.act(button.dataset.action, node.name));
      cells.actions.append(button);
      buttons[action] = button;
    }
    // A supervisor has no such actions: its buttons are not shown.
    for (const action of ["kill", "stop", "restart"]) buttons[action] ??= document.createElement("button");
    return { element, cells, buttons, pid: null, state: null, was: null };
  }

  // Processes that do not run come first, then the team in its order; a large team is folded.
  order() {
    const rank = (node) => (isWell(node.state) || (node.name === SUPERVISOR && node.pid == null) ? 1 : 0);
    const isLarge = this.nodes.length > FEW;
    const sorted = isLarge ? this.nodes.toSorted((a, b) => rank(a) - rank(b)) : this.nodes;
    const shown = isLarge && !this.isOpen ? sorted.slice(0, FEW - 2) : sorted;
    const elements = shown.map((node) => this.rows.get(node.name).element);
    // Moves a row only if necessary, because a moved row loses the keyboard's focus.
    const isSame = this.body.children.length === elements.length && elements.every((element, index) => this.body.children[index] === element);
    if (!isSame) this.body.replaceChildren(...elements);
    this.fold.hidden = !isLarge;
    const down = this.nodes.filter((node) => rank(node) === 0).length;
    this.fold.textContent = this.isOpen ? "show fewer" : `show all ${this.nodes.length} processes, ${down} not running`;
  }

  async act(action, node) {
    this.say(`${action} ${node} …`);
    try {
      const answer = await fetch(`/act/${action}/${node}`, { method: "POST", headers: { "x-rangehound-token": this.token } });
      this.say(await answer.text(), !answer.ok);
    } catch {
      this.say(`${action} ${node}: the page's server does not answer`, true);
    }
  }

  say(text, isBad = false) {
    this.message.textContent = text;
    this.message.classList.toggle("bad", isBad);
  }
}

// A good state: running, or ended.
const isWell = (state) => state === "running" || state === "ended";

function label(button, action, node) {
  if (button.dataset.action === action) return;
  button.dataset.action = action;
  button.textContent = action;
  button.setAttribute("aria-label", `${action} ${node}`);
}

function was(pid) {
  const old = document.createElement("span");
  old.className = "was";
  old.textContent = `${pid} →`;
  return old;
}

// Restarts the animation if it is still running.
function flash(element) {
  element.classList.remove("flash");
  void element.offsetWidth;
  element.classList.add("flash");
}
