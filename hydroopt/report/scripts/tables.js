// A click on a heading sorts its table, a second one the other way, a third restores the order.
const SUPERSCRIPT = "⁰¹²³⁴⁵⁶⁷⁸⁹";

function sortKey(cell) {
  const text = cell ? cell.textContent.trim().replace(/[\u202f\u00a0]/g, "").replace(/−/g, "-") : "";
  const found = /^[<±]?(-?\d[\d.]*(?:e[-+]?\d+)?)(?:×10(⁻?)([⁰¹²³⁴⁵⁶⁷⁸⁹]+))?/.exec(text);
  if (!found) return text === "—" || text === "" ? null : text.toLowerCase();
  const power = found[3] ? [...found[3]].reduce((sum, c) => 10 * sum + SUPERSCRIPT.indexOf(c), 0) : 0;
  return +found[1] * 10 ** (found[2] ? -power : power);
}

function compared(a, b) {
  if (a === null || b === null) return (a === null) - (b === null);
  if (typeof a === typeof b) return a < b ? -1 : a > b ? 1 : 0;
  return typeof a === "number" ? -1 : 1;
}

// Rows of numbers that the data do not determine can be left out; paper shows them all.
const FEW = 6;
function fewer(table, body) {
  const rows = [...body.rows], owners = rows.filter((row) => row.classList.contains("owner"));
  const idle = rows.filter((row) => [...row.querySelectorAll(".chip")].some((chip) => chip.textContent === "none"));
  if (idle.length < FEW || idle.length + owners.length === rows.length) return;
  for (const row of idle) row.classList.add("idle");
  owners.forEach((owner) => {
    let next = owner.nextElementSibling, used = false;
    for (; next && !next.classList.contains("owner"); next = next.nextElementSibling) used ||= !next.classList.contains("idle");
    owner.classList.toggle("idle", !used);
  });
  const box = element("input", { type: "checkbox" });
  const show = () => table.classList.toggle("fewer", !box.checked);
  box.addEventListener("change", show);
  show();
  (table.closest(".scroll") || table).before(element("label", { class: "small all" }, box, `show ${idle.length} more that the data do not identify`));
}

for (const table of document.querySelectorAll("main table:not([data-fixed])")) {
  const heading = table.tHead && table.tHead.rows[table.tHead.rows.length - 1], body = table.tBodies[0];
  if (!heading || !body) continue;
  fewer(table, body);
  const order = [...body.rows], rows = order.filter((row) => !row.classList.contains("owner") && !row.classList.contains("total"));
  if (rows.length < 3) continue;
  [...heading.cells].forEach((cell, k) => {
    if (!cell.textContent.trim()) return;
    const button = element("button", { type: "button", class: "sort" });
    button.append(...cell.childNodes);
    cell.append(button);
    button.addEventListener("click", () => {
      const next = { ascending: "descending", descending: "none" }[cell.getAttribute("aria-sort")] || "ascending";
      for (const other of heading.cells) other.removeAttribute("aria-sort");
      const sign = next === "descending" ? -1 : 1;
      const sorted = rows.map((row) => [sortKey(row.cells[k]), row])
        .sort(([a], [b]) => (a === null || b === null ? compared(a, b) : sign * compared(a, b))).map(([, row]) => row);
      const rest = order.filter((row) => !rows.includes(row));
      rest.forEach((row) => { row.hidden = next !== "none" && row.classList.contains("owner"); });
      body.append(...(next === "none" ? order : [...sorted, ...rest]));
      if (next !== "none") cell.setAttribute("aria-sort", next);
    });
  });
}

// A table that is wider than its window can be moved by the keyboard.
for (const box of document.querySelectorAll(".scroll:not([tabindex])")) {
  const section = box.closest("section"), heading = section && section.querySelector("h2, h3");
  new ResizeObserver(() => {
    const wide = box.scrollWidth > box.clientWidth;
    for (const [key, value] of [["tabindex", "0"], ["role", "group"], ["aria-label", heading ? heading.textContent : "table"]]) {
      if (wide) box.setAttribute(key, value); else box.removeAttribute(key);
    }
  }).observe(box);
}
