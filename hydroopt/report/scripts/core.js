// Data of the page, its colours, the clock that machine and figures share, and the light or dark look.
const page = JSON.parse(document.getElementById("page-data").textContent);

function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

const samples = page.samples && page.samples.at
  ? { ...page.samples, at: unpack(page.samples.at), columns: {}, raw: page.samples.columns } : null;

function column(name) {
  if (!(name in samples.columns)) samples.columns[name] = unpack(samples.raw[name]);
  return samples.columns[name];
}

const number = (x) => !Number.isFinite(x) ? "—"
  : (Math.abs(x) >= 1e5 || (x !== 0 && Math.abs(x) < 1e-3) ? x.toExponential(2) : String(+x.toPrecision(4)))
    .replaceAll("-", "−");

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "class") made.className = value; else made.setAttribute(key, value);
  }
  made.append(...children);
  return made;
}

// Colours stand in the style sheet alone: a probe resolves them in the present look.
const look = (() => {
  const probe = element("span", { hidden: "" }), known = {}, listeners = [];
  document.body.append(probe);
  const changed = () => {
    for (const key of Object.keys(known)) delete known[key];
    for (const listener of listeners) listener();
  };
  const set = (name) => {
    if (name) document.documentElement.dataset.theme = name; else delete document.documentElement.dataset.theme;
    changed();
  };
  const dark = () => (document.documentElement.dataset.theme
    || (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", changed);
  let before;
  addEventListener("beforeprint", () => { before = document.documentElement.dataset.theme; set("light"); });
  addEventListener("afterprint", () => set(before));
  return {
    dark, set, listen: (listener) => listeners.push(listener),
    colour(name) {
      if (!known[name]) { probe.style.color = `var(--${name})`; known[name] = getComputedStyle(probe).color; }
      return known[name];
    },
  };
})();

// Viridis in nine steps: even in lightness also to colour-blind eyes, and nowhere grey as parts without a number are.
const RAMP = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"]
  .map((text) => [1, 3, 5].map((k) => parseInt(text.slice(k, k + 2), 16)));

function ramp(part) {
  const at = Math.min(Math.max(part, 0), 1) * (RAMP.length - 1), k = Math.min(Math.floor(at), RAMP.length - 2);
  return RAMP[k].map((low, c) => Math.round(low + (at - k) * (RAMP[k + 1][c] - low)));
}
const rampCss = (part) => `rgb(${ramp(part).join(",")})`;

// The clock: a place among the samples, with fractions in between; all that shows the present listens to it.
const clock = samples && (() => {
  const at = samples.at, last = at.length - 1, listeners = [];
  let index = 0, playing = null, speed = 1;
  const steps = !samples.clock.startsWith("time");
  const set = (next) => {
    index = Math.min(Math.max(next, 0), last);
    for (const listener of listeners) listener(index);
  };
  const indexOf = (t) => {
    let low = 0, high = last;
    while (high - low > 1) { const middle = (low + high) >> 1; if (at[middle] <= t) low = middle; else high = middle; }
    const step = at[high] - at[low];
    return step > 0 ? low + Math.min(Math.max((t - at[low]) / step, 0), 1) : low;
  };
  const time = () => {
    const k = Math.min(Math.floor(index), last), f = index - k;
    return f > 0 ? at[k] + f * (at[k + 1] - at[k]) : at[k];
  };
  const tick = (before) => (now) => {
    if (!playing) return;
    const seconds = Math.min((now - before) / 1000, 0.1);
    if (index >= last) set(0); else set(indexOf(time() + seconds * speed * (steps ? 2 : 1)));
    playing = requestAnimationFrame(tick(now));
  };
  return {
    last, steps, set, time, listen: (listener) => listeners.push(listener),
    get index() { return index; }, get nearest() { return Math.round(index); }, get playing() { return Boolean(playing); },
    setTime: (t) => set(indexOf(t)), setSpeed: (value) => { speed = value; },
    play(on) {
      if (playing) cancelAnimationFrame(playing);
      playing = on ? requestAnimationFrame(tick(performance.now())) : null;
    },
  };
})();

for (const button of document.querySelectorAll("[data-theme-toggle]")) {
  button.hidden = false;
  button.addEventListener("click", () => look.set(look.dark() ? "light" : "dark"));
}

for (const player of clock ? document.querySelectorAll("[data-player]") : []) {
  const [play, range, shown, speed] = ["button", "input", "output", "select"].map((tag) => player.querySelector(tag));
  player.hidden = false;
  range.max = clock.last;
  play.addEventListener("click", () => {
    clock.play(!clock.playing);
    play.setAttribute("aria-pressed", String(clock.playing));
    play.classList.toggle("playing", clock.playing);
  });
  range.addEventListener("input", () => clock.set(clock.steps ? Math.round(+range.value) : +range.value));
  if (speed) speed.addEventListener("change", () => clock.setSpeed(+speed.value));
  clock.listen((index) => {
    range.value = index;
    const span = samples.spans.find((s) => index >= s.first - 1 && index <= s.last + 1);
    const name = span && span.role ? `, ${span.role}` : "";
    shown.textContent = clock.steps ? `${Math.round(index) + 1} of ${clock.last + 1}${name}` : `${clock.time().toFixed(2)} s${name}`;
    range.setAttribute("aria-valuetext", shown.textContent);
  });
}
