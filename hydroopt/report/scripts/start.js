// Everything is in place: show the first sample at which all figures have numbers, and let tests read what is shown.
if (clock) {
  const shown = page.charts.filter((chart) => chart.kind === "time").flatMap((chart) => chart.lines.map((line) => column(line.column)));
  const full = samples.at.findIndex((_, k) => shown.every((values) => Number.isFinite(values[k])));
  clock.set(Math.max(full, 0));
}
window.hydroopt = { page, clock, machine, view, plots, timePlots, look, column };
