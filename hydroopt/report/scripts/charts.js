// Figures over time, against other columns and over the workspace, drawn by uPlot; hovering moves the clock.
const plots = [], timePlots = [];
const DASH = [5, 4];

// Of a logarithmic axis only powers of ten have lines.
const decades = (u, splits, axis) => u.scales[u.axes[axis].scale].distr !== 3 ? splits
  : splits.map((v) => Math.abs(Math.log10(v) - Math.round(Math.log10(v))) < 1e-9 ? v : null);

function axes(across, up = "") {
  const one = { stroke: () => look.colour("soft"), grid: { stroke: () => look.colour("grid"), width: 1, filter: decades },
    ticks: { stroke: () => look.colour("grid"), width: 1, size: 4, filter: decades }, font: "11px system-ui, sans-serif",
    labelFont: "11px system-ui, sans-serif", labelSize: 16, labelGap: 0,
    values: (u, splits) => splits.map((v) => v === null ? "" : number(v)) };
  return [{ ...one, label: across || undefined, size: 26 },
    { ...one, label: up || undefined, size: (u, values) => 14 + 6.2 * Math.max(2, ...(values || []).map((v) => v ? String(v).length : 0)) }];
}

function drawn(figure, options, data, aspect = 0) {
  const holder = figure.querySelector(".plot");
  const height = () => aspect ? Math.round(Math.min(aspect * holder.clientWidth, 420)) : +(figure.dataset.height || 170);
  const plot = new uPlot({ width: Math.max(holder.clientWidth, 120), height: height(), legend: { show: false },
    padding: [8, 16, 0, 0], ...options,  // half of the last number stands right of its tick
    cursor: { x: false, y: false, points: { show: false }, drag: { x: false, y: false }, ...options.cursor } }, data, holder);
  new ResizeObserver(() => {
    const width = holder.clientWidth;
    if (width > 0 && width !== plot.width) plot.setSize({ width, height: height() });
  }).observe(holder);
  plots.push(plot);
  return plot;
}
look.listen(() => plots.forEach((plot) => plot.redraw(false, true)));

// --- lines over the clock ---

let zooming = false;
function zoomed(plot, key) {
  if (key !== "x" || zooming || !plot.scales.x) return;
  zooming = true;
  const { min, max } = plot.scales.x;
  for (const other of timePlots) if (other !== plot) other.setScale("x", { min, max });
  zooming = false;
}

function box(u, x0, x1, y0, y1, fill) {
  const [left, right] = [u.valToPos(x0, "x", true), u.valToPos(x1, "x", true)];
  const { left: l, top: t, width: w, height: h } = u.bbox;
  const [top, bottom] = y0 === undefined ? [t, t + h] : [u.valToPos(y1, "y", true), u.valToPos(y0, "y", true)];
  const [a, b] = [Math.max(left, l), Math.min(right, l + w)], [c, d] = [Math.max(top, t), Math.min(bottom, t + h)];
  u.ctx.fillStyle = fill;
  if (b > a && d > c) u.ctx.fillRect(a, c, b - a, d - c);
}

function rule(u, value, colour) {
  const y = u.valToPos(value, "y", true), { left, width, top, height } = u.bbox;
  if (!(y >= top && y <= top + height)) return;
  u.ctx.save();
  u.ctx.strokeStyle = colour;
  u.ctx.lineWidth = devicePixelRatio;
  u.ctx.setLineDash([6 * devicePixelRatio, 4 * devicePixelRatio]);
  u.ctx.beginPath(); u.ctx.moveTo(left, y); u.ctx.lineTo(left + width, y); u.ctx.stroke();
  u.ctx.restore();
}

const gaps = (values) => Array.from(values, (v) => Number.isFinite(v) ? v : null);

// Shaded bands lie between pairs of series that are not drawn themselves.
const HIDDEN = { width: 0, points: { show: false } };
const between = (first, names) => names.map((name, k) => ({ series: [first + 2 * k + 1, first + 2 * k],
  fill: () => look.colour(name).replace("rgb(", "rgba(").replace(")", ", 0.18)") }));

function keys(figure, lines) {
  const holder = element("div", { class: "keys", "aria-hidden": "true" });
  const values = lines.map(({ label, look: name, dashed, dots }) => {
    const value = element("b"), swatch = element("i", { class: dots ? "dot" : dashed ? "dashed" : "" });
    swatch.style.color = `var(--${name})`;
    holder.append(element("span", { class: "key" }, ...(lines.length > 1 ? [swatch, label, " "] : []), value));
    return value;
  });
  figure.querySelector(".plot").before(holder);
  return values;
}

// A clock that counts poses has ticks at whole numbers.
function timeAxes(across) {
  const [x, y] = axes(across), whole = samples.clock.startsWith("pose");
  return [whole ? { ...x, incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000, 10000] } : x, y];
}

function timeChart(figure, chart) {
  const values = keys(figure, chart.lines);
  const series = chart.lines.map((line) => ({
    stroke: () => look.colour(line.look), width: line.look === "measured" ? 2 : 1.2, dash: line.dashed ? DASH : undefined,
    paths: line.dots ? () => null : undefined, spanGaps: false,
    points: { show: Boolean(line.dots), size: 4, width: 0, fill: () => look.colour(line.look) } }));
  const y = chart.logarithmic ? { distr: 3 } : chart.span ? { range: chart.span } : {};
  const zero = chart.lines.map((line) => 1e-6 * column(line.column).reduce((most, v) => Math.max(most, Math.abs(v) || 0), 0));
  const marker = element("div", { class: "now" });
  const edges = chart.shaded.flatMap(([, low, high]) => [low, high]);
  const plot = drawn(figure, {
    series: [{}, ...series, ...edges.map(() => HIDDEN)], bands: between(series.length + 1, chart.shaded.map(([name]) => name)),
    scales: { x: { time: false }, y },
    axes: timeAxes(figure.hasAttribute("data-last") ? samples.clock : ""),
    cursor: { drag: { x: true, y: false, setScale: true } },
    hooks: {
      setScale: [zoomed, () => move()],
      drawClear: [(u) => {
        for (const s of samples.spans.filter((each) => each.role === "validation" || each.role === "held out")) {
          box(u, samples.at[s.first], samples.at[s.last], undefined, undefined, look.colour("shade"));
        }
        if (chart.band) box(u, u.scales.x.min, u.scales.x.max, ...chart.band, look.colour("band"));
      }],
      draw: [(u) => chart.limits.forEach((value) => rule(u, value, look.colour("ink")))],
    },
  }, [Array.from(samples.at), ...[...chart.lines.map((line) => line.column), ...edges].map((name) => gaps(column(name)))]);
  plot.over.append(marker);
  timePlots.push(plot);
  const move = () => {
    const x = plot && plot.valToPos(clock.time(), "x");
    marker.style.transform = `translateX(${x}px)`;
    marker.hidden = !(x >= 0 && x <= plot.over.clientWidth);
  };
  clock.listen(() => {
    move();
    chart.lines.forEach((line, k) => {
      const value = column(line.column)[clock.nearest];
      values[k].textContent = number(Math.abs(value) < zero[k] ? 0 : value);
    });
  });
  const hover = (event) => clock.setTime(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x"));
  plot.over.addEventListener("pointermove", (event) => { if (!event.buttons || event.pointerType !== "mouse") hover(event); });
  plot.over.addEventListener("pointerdown", (event) => { if (event.pointerType !== "mouse") hover(event); });
  return plot;
}

// --- dots, cells and curves over other columns ---

function extent(values, pad = 0.04) {
  let low = Infinity, high = -Infinity;
  for (const v of values) if (Number.isFinite(v)) { low = Math.min(low, v); high = Math.max(high, v); }
  if (!(high > low)) return [low - 1 || -1, low + 1 || 1];
  return [low - pad * (high - low), high + pad * (high - low)];
}

function field(figure, chart, x, y, across, up, draw, aspect) {
  const spanX = extent(x), spanY = extent(y);
  return drawn(figure, {
    series: [{}, { paths: () => null, points: { show: false } }], axes: axes(across, up),
    scales: { x: { time: false, range: spanX }, y: { range: spanY } }, hooks: { draw: [draw] },
  }, [spanX, spanY], aspect);
}

function dot(u, x, y, size) {
  u.ctx.beginPath();
  u.ctx.arc(u.valToPos(x, "x", true), u.valToPos(y, "y", true), size * devicePixelRatio, 0, 2 * Math.PI);
}

function cloud(figure, chart) {
  const x = column(chart.x), y = column(chart.y);
  const held = samples.spans.filter((s) => s.role !== "training");
  if (held.length && held.length < samples.spans.length) {
    keys(figure, [{ label: "training", look: "predicted", dots: true }, { label: held[0].role, look: "other", dots: true }]);
  }
  const plot = field(figure, chart, x, y, chart.across, "", (u) => {
    if (chart.band) box(u, u.scales.x.min, u.scales.x.max, ...chart.band, look.colour("band"));
    const size = 1.4 * devicePixelRatio;
    for (let k = 0; k < x.length; k++) {
      if (!Number.isFinite(x[k]) || !Number.isFinite(y[k])) continue;
      u.ctx.fillStyle = look.colour(held.some((s) => k >= s.first && k <= s.last) ? "other" : "predicted");
      u.ctx.globalAlpha = 0.55;
      u.ctx.fillRect(u.valToPos(x[k], "x", true) - size, u.valToPos(y[k], "y", true) - size, 2 * size, 2 * size);
    }
    u.ctx.globalAlpha = 1;
  });
  const here = element("div", { class: "here" });
  plot.over.append(here);
  const place = () => {
    const k = clock.nearest, known = Number.isFinite(x[k]) && Number.isFinite(y[k]);
    here.hidden = !known;
    if (known) here.style.transform = `translate(${plot.valToPos(x[k], "x")}px, ${plot.valToPos(y[k], "y")}px)`;
  };
  clock.listen(place);
  plot.hooks.draw = [...(plot.hooks.draw || []), place];
  plot.over.addEventListener("click", (event) => {
    const area = plot.over.getBoundingClientRect();
    let best = -1, least = Infinity;
    for (let k = 0; k < x.length; k++) {
      if (!Number.isFinite(x[k]) || !Number.isFinite(y[k])) continue;
      const away = (plot.valToPos(x[k], "x") - event.clientX + area.left) ** 2 + (plot.valToPos(y[k], "y") - event.clientY + area.top) ** 2;
      if (away < least) { least = away; best = k; }
    }
    if (best >= 0) clock.set(best);
  });
}

const CELLS = 24;
function heatMap(figure, chart, tip) {
  const own = chart.kind === "field", values = own ? unpack(chart.value) : column(chart.value);
  const place = own ? [unpack(chart.x), unpack(chart.y)] : tip();
  const [x, y] = place, spans = [extent(x, 0), extent(y, 0)], sum = new Float64Array(CELLS * CELLS), count = new Uint32Array(CELLS * CELLS);
  const cell = (value, [low, high]) => Math.min(CELLS - 1, Math.floor(CELLS * (value - low) / (high - low)));
  for (let k = 0; k < values.length; k++) {
    if (![values[k], x[k], y[k]].every(Number.isFinite)) continue;
    const at = cell(x[k], spans[0]) + CELLS * cell(y[k], spans[1]);
    sum[at] += Math.abs(values[k]); count[at] += 1;
  }
  const means = Array.from(sum, (s, k) => count[k] ? s / count[k] : NaN), known = means.filter(Number.isFinite).sort((a, b) => a - b);
  if (!known.length) { figure.hidden = true; return; }
  const top = known[Math.floor(0.98 * (known.length - 1))] || 1, low = known[Math.floor(0.02 * (known.length - 1))];
  const bottom = own && top - low > 0.05 * top ? low : 0;  // standard deviations hardly come near to zero
  const corner = (k, side) => spans[side][0] + k * (spans[side][1] - spans[side][0]) / CELLS;
  field(figure, chart, x, y, chart.across || "reach from the base's axis [m]", chart.up || "height [m]", (u) => {
    means.forEach((mean, at) => {
      if (!Number.isFinite(mean)) return;
      const i = at % CELLS, j = Math.floor(at / CELLS);
      box(u, corner(i, 0), corner(i + 1, 0) + 1e-9, corner(j, 1), corner(j + 1, 1), rampCss((mean - bottom) / (top - bottom)));
    });
  }, 0.72);
  figure.querySelector(".plot").before(scale(chart.unit, top, bottom));
  const worst = means.indexOf(Math.max(...known)), middle = known[Math.floor(known.length / 2)];
  const where = `${number(corner(worst % CELLS + 0.5, 0))} and ${number(corner(Math.floor(worst / CELLS) + 0.5, 1))}`;
  figure.querySelector(".plot").setAttribute("aria-label", `${chart.title}: median over the cells ${number(middle)} ${chart.unit}, `
    + `largest ${number(known[known.length - 1])} ${chart.unit} at ${chart.across || "reach"} and ${chart.up || "height"} of ${where}.`);
}

function scale(unit, top, bottom = 0) {
  const bar = element("span", { class: "ramp" });
  bar.style.background = `linear-gradient(90deg, ${RAMP.map((_, k) => rampCss(k / (RAMP.length - 1))).join(",")})`;
  return element("div", { class: "keys" }, element("span", {}, number(bottom)), bar, element("span", {}, `${number(top)} ${unit}`));
}

function curves(figure, chart) {
  const x = unpack(chart.x), lines = chart.lines.map((line) => ({ ...line, values: unpack(line.values) }));
  const bands = chart.bands.map((band) => ({ ...band, low: unpack(band.low), high: unpack(band.high) }));
  if (lines.length > 1) keys(figure, lines.map((line) => ({ ...line, dots: chart.dots })));
  const [flat, upright] = axes(chart.across);
  if (chart.ticks) upright.incrs = [1, 2, 4, 8, 16, 32].map((k) => k * chart.ticks);
  drawn(figure, {
    series: [{}, ...lines.map((line) => ({ stroke: () => look.colour(line.look), width: 1.5, paths: chart.dots ? () => null : undefined,
      points: { show: chart.dots, size: 5, width: 0, fill: () => look.colour(line.look) } })), ...bands.flatMap(() => [HIDDEN, HIDDEN])],
    bands: between(lines.length + 1, bands.map((band) => band.look)),
    scales: { x: { time: false, distr: chart.logarithmic[0] ? 3 : 1 }, y: { distr: chart.logarithmic[1] ? 3 : 1 } },
    axes: [flat, upright], hooks: { draw: [(u) => chart.limits.forEach((value) => rule(u, value, look.colour("ink")))] },
  }, [Array.from(x), ...lines.map((line) => gaps(line.values)), ...bands.flatMap((band) => [gaps(band.low), gaps(band.high)])]);
}

function plane(figure, chart) {
  const lines = chart.lines.map((line) => ({ ...line, x: unpack(line.x), y: unpack(line.y) }));
  const dots = chart.dots.map((some) => ({ ...some, dots: true, x: unpack(some.x), y: unpack(some.y) }));
  const [left, right, low, high] = chart.span;
  keys(figure, [...lines, ...dots]);
  const circles = chart.circles.map(([x, y, radius]) => Array.from({ length: 91 }, (_, k) =>
    [x + radius * Math.cos(k * Math.PI / 45), y + radius * Math.sin(k * Math.PI / 45)]));
  drawn(figure, {
    series: [{}, { paths: () => null, points: { show: false } }], axes: axes(chart.across, chart.up),
    scales: { x: { time: false, range: [left, right] }, y: { range: [low, high] } },
    hooks: { draw: [(u) => {
      const { ctx } = u, place = (x, y) => [u.valToPos(x, "x", true), u.valToPos(y, "y", true)];
      ctx.save();
      ctx.beginPath(); ctx.rect(u.bbox.left, u.bbox.top, u.bbox.width, u.bbox.height); ctx.clip();
      const trace = (points, colour, width, dash) => {
        ctx.strokeStyle = colour; ctx.lineWidth = width * devicePixelRatio; ctx.setLineDash(dash.map((d) => d * devicePixelRatio));
        ctx.beginPath(); points.forEach(([x, y], k) => ctx[k ? "lineTo" : "moveTo"](...place(x, y))); ctx.stroke();
      };
      for (const circle of circles) trace(circle, look.colour("ink"), 1, [6, 4]);
      for (const line of lines) trace(Array.from(line.x, (x, k) => [x, line.y[k]]), look.colour(line.look), 1.5, []);
      for (const some of dots) some.x.forEach((x, k) => {
        const [a, b] = place(x, some.y[k]), size = 3.5 * devicePixelRatio;
        ctx.strokeStyle = look.colour(some.look); ctx.lineWidth = 1.5 * devicePixelRatio; ctx.setLineDash([]);
        ctx.beginPath();
        if (some.label.endsWith("poles")) for (const side of [1, -1]) { ctx.moveTo(a - size, b - side * size); ctx.lineTo(a + size, b + side * size); }
        else ctx.arc(a, b, size, 0, 2 * Math.PI);
        ctx.stroke();
      });
      ctx.restore();
    }] },
  }, [[left, right], [low, high]], (high - low) / (right - left));
}

for (const figure of document.querySelectorAll("figure[data-chart]")) {
  const chart = page.charts[+figure.dataset.chart];
  if (chart.kind === "time") timeChart(figure, chart);
  else if (chart.kind === "cloud") cloud(figure, chart);
  else if (chart.kind === "plane") plane(figure, chart);
  else if (chart.kind === "map" || chart.kind === "field") heatMap(figure, chart, () => machine.tipPlaces());
  else curves(figure, chart);
}
for (const button of timePlots.length ? document.querySelectorAll("[data-zoom-reset]") : []) {
  button.hidden = false;
  button.addEventListener("click", () => timePlots[0].setScale("x", { min: samples.at[0], max: samples.at[clock.last] }));
}
