// Numbers with their units, and the row of key figures.

// Three significant digits, without powers of ten if possible.
export function number(value) {
  if (value == null) return "–";
  const size = Math.abs(value);
  if (size === 0) return "0";
  if (size >= 1e6 || size < 1e-4) return value.toExponential(1);
  if (size >= 1000) return whole(value);
  return String(Number(value.toPrecision(3)));
}

// As `number`, shorter, for an axis.
export function axisNumber(value) {
  const size = Math.abs(value);
  if (size >= 1e9 || size < 1e4) return number(value);
  return size >= 1e6 ? `${number(value / 1e6)}M` : `${number(value / 1e3)}k`;
}

// The next number that is 1, 2 or 5 times a power of ten.
export function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= least);
}

// Groups of three digits, with narrow spaces.
export const whole = (value) => Math.round(value).toString().replace(/\B(?=(\d{3})+$)/g, "\u202f");

export const metres = (value) => (value == null ? "–" : `${value >= 10 ? value.toFixed(1) : value.toFixed(2)} m`);

export const micros = (value) => (value == null ? "–" : value >= 1000 ? `${number(value / 1e3)} ms` : `${number(value)} µs`);

// A count with few digits.
export const rough = (value) => (value >= 1e6 ? `${number(value / 1e6)} M` : whole(value));

function percentiles(some) {
  if (!some) return "–";
  return [some.p50, some.p90, some.p99].map((value) => micros(value).replace(/ (\S+)$/, "<small> $1</small>")).join(" · ");
}

function figuresOf({ tick, time_s, ticks_per_s, counts, latency }, about) {
  return [
    ["tick", `${whole(tick)} <small>of ${rough(about.ticks)}</small>`],
    ["time", `${time_s >= 100 ? whole(time_s) : (time_s ?? 0).toFixed(1)} <small>s</small>`],
    ["speed", `${ticks_per_s == null ? "–" : number(ticks_per_s)} <small>ticks/s</small>`],
    [`${about.measured} fused`, rough(counts.fused)],
    ["rejected", whole(counts.rejected)],
    ["late", whole(counts.late)],
    ["missing", whole(counts.missing)],
    ["range to heading p50 · p90 · p99", percentiles(latency.all), "wide"],
    ["the same, last seconds", percentiles(latency.recent), "wide"],
  ];
}

// Elements are made once; later only changes are written.
export function showFigures(place, picture, about) {
  figuresOf(picture, about).forEach(([name, html, kind], index) => {
    let card = place.children[index];
    if (!card) {
      card = document.createElement("div");
      card.innerHTML = "<dt></dt><dd></dd>";
      if (kind) card.className = kind;
      card.firstElementChild.textContent = name;
      place.append(card);
    }
    if (card.lastElementChild.dataset.html !== html) {
      card.lastElementChild.dataset.html = html;
      card.lastElementChild.innerHTML = html;
    }
  });
}
