// Marks of methods, numbers and sentences, tables, and the note beside the pointer.
"use strict";
(() => {
  const { html, svg, data } = stepbench;
  // Marks are polygons within -1 to 1: those that Vega knows by name, and paths.
  const SHAPES = {
    "square": "M-.72,-.72L.72,-.72L.72,.72L-.72,.72Z", "diamond": "M0,-1.04L.96,0L0,1.04L-.96,0Z",
    "triangle-up": "M0,-.96L.92,.64L-.92,.64Z", "triangle-down": "M0,.96L.92,-.64L-.92,-.64Z",
    "triangle-right": "M.96,0L-.64,.92L-.64,-.92Z", "triangle-left": "M-.96,0L.64,.92L.64,-.92Z",
    "cross": "M-.32,-.96L.32,-.96L.32,-.32L.96,-.32L.96,.32L.32,.32L.32,.96L-.32,.96L-.32,.32L-.96,.32L-.96,-.32L-.32,-.32Z",
  };
  const shape = (method, r) => {
    if (method.shape === "circle") return `m${-r} 0a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0z`;
    const path = SHAPES[method.shape] ?? method.shape, points = path.slice(1, -1).split("L").map((p) => p.split(",").map((value) => 1.25 * r * value));
    return points.map(([x, y], k) => k ? `l${x - points[k - 1][0]} ${y - points[k - 1][1]}` : `m${x} ${y}`).join("") + "z";
  };
  // A colour of a method that follows light and dark; paper is always light.
  const colour = (method) => `light-dark(${method.light}, ${method.dark})`;
  const badge = (method) => svg("svg", { class: "badge", viewBox: "0 0 14 14", width: 14, height: 14, "aria-hidden": "true" },
    svg("path", { d: "M7 7" + shape(method, 4.4), style: `fill: ${colour(method)}` }));

  // A link to a page of the report, and the head of a method's row.
  const to = (page, attributes, ...children) => html("a", { ...attributes, href: stepbench.page(page) }, ...children);
  const head = (method) => html("th", { scope: "row" }, badge(method), to(method.page, { title: method.label }, method.short));
  // A part of a sentence is text, whose numbers such as 1e-4 stay in one line, or the place of a reference to something in the report.
  const part = (item) => {
    if (typeof item === "string" && /\de-/.test(item)) return html("span", {}, ...item.split(/([\d.]+e-\d+)/).map((text, k) => k % 2 ? html("span", { class: "whole" }, text) : text));
    if (typeof item === "string" || item instanceof Node) return item;
    const method = item.kind === "method" && data.methods.find((m) => m.label === item.key);
    const style = method ? `color: color-mix(in oklab, ${colour(method)} 70%, var(--ink))` : null;
    const looks = { class: item.kind, title: item.key, style }, text = item.text || item.key;
    return item.page ? to(item.page, looks, text) : html("span", looks, text);
  };
  // Sentences on runs that reach the end and are wrong, as paragraphs.
  const wrong = (of, which) => (data.wrong[stepbench.question.group]?.[of][which] || []).map(
    (parts) => html("p", { class: parts.at(-1) !== data.headlines.fine && "wrong" }, ...parts.map(part)));
  const columns = (...names) => html("tr", {}, ...names.map((name) => html("th", { scope: "col" }, name)));
  const fill = (table, caption, heads, rows) => table.replaceChildren(
    html("caption", {}, html("span", {}, caption)), html("thead", {}, ...heads), html("tbody", {}, ...rows));

  // Three significant digits, as in the tables and sentences (bench/results/table.py).
  const number = (value) => {
    if (value < 1e-35) return "0";
    const rounded = Number(value.toPrecision(3));
    if (rounded >= 1e-4 && value < 1e6) return rounded >= 100 ? rounded.toFixed(0) : String(rounded);
    return rounded.toExponential().replace("e+", "e");
  };
  const TICKS = [[1e12, "\u202fT"], [1e9, "\u202fG"], [1e6, "\u202fM"], [1e3, "\u202fk"], [1, ""]];
  const TIMES = [[1, " s"], [1e-3, " ms"], [1e-6, " µs"]];
  // A cost at a tick of an axis, in few characters with its unit.
  const costTick = (value, cost) => {
    const units = cost === "seconds" ? TIMES : TICKS, [size, unit] = units.find(([least]) => value >= least * .9995) || units.at(-1);
    const own = value / size;
    return value < 1e-35 ? "0" : `${own >= 100 ? Math.round(own) : Number(own.toPrecision(3))}${unit}`;
  };
  // A cost as in tables and sentences (reports/formatting.py).
  const costText = (value, cost) => {
    if (cost === "seconds") return value >= 1 ? `${number(value)} s` : `${number(1e3 * value)} ms`;
    const [size, word] = [[1e9, " billion"], [1e6, " million"]].find(([least]) => value >= least) || [1, ""];
    return `${number(value / size)}${word}`;
  };
  const costWithUnit = (value, cost) => cost === "seconds" ? costText(value, cost) : `${costText(value, cost)} ${data.units[cost]}`;
  // A ratio with as many digits as tell it from 1, as in sentences.
  const multiple = (ratio) => ratio > 1e35 ? "∞" : number(ratio) !== "1" ? number(ratio) : String(Number(ratio.toPrecision(6)));
  // A multiple in a cell with little room.
  const times = (value) => value > 1e35 ? "∞" : value < 10 ? value.toFixed(1) : value < 9999.5 ? value.toFixed(0) : value.toExponential(0).replace("e+", "e");

  // The median of values with its interval, and the quotient of the times of two runs, as bench/results/timings.py has them.
  const middle = (values) => {
    const own = values.toSorted((one, two) => one - two), n = own.length, cut = data.cuts[n];
    return { value: (own[(n - 1) >> 1] + own[n >> 1]) / 2, low: own[cut], high: own[n - 1 - cut], few: n < data.fewest, precise: n > 1 || own[0] > data.long };
  };
  const quotient = (one, two) => {
    const all = [one, two].map(Object.values), shared = Object.keys(one).filter((k) => k in two).map((k) => two[k] / one[k]), [a, b] = all.map(middle);
    if (shared.length && shared.length >= Math.min(all[0].length, all[1].length)) return middle(shared);
    return a.precise && b.precise ? { value: b.value / a.value, low: b.low / a.high, high: b.high / a.low, few: a.few || b.few } : null;
  };
  // Names in a margin: cut if they are long, and the room that they take.
  const LONGEST = 30;
  const cut = (name) => name.length > LONGEST ? `${name.slice(0, LONGEST - 1)}…` : name;
  const room = (names) => Math.ceil(7.6 * Math.max(6, ...names.map((name) => cut(name).length)));

  // One note for the whole page; screen readers hear it when it comes by keyboard.
  const note = html("div", { class: "tip", role: "status", hidden: "" });
  document.body.append(note);
  const tip = {
    show(lines, x, y) {
      note.replaceChildren(...lines.map((line, k) => html(k ? "span" : "strong", {}, ...[line].flat())));
      note.hidden = false;
      const { offsetWidth: wide, offsetHeight: high } = note;
      const left = x + 14 + wide > innerWidth ? x - 14 - wide : x + 14;
      note.style.left = `${Math.max(4, left) + scrollX}px`;
      note.style.top = `${Math.max(4, Math.min(y + 12, innerHeight - high - 4)) + scrollY}px`;
    },
    hide() { note.hidden = true; },
  };
  window.addEventListener("keydown", (event) => { if (event.key === "Escape") tip.hide(); });

  // Whether the question is about constraints; methods hold them up to the rounding of Φ.
  const violation = ({ group }) => group.startsWith("constraint");
  // The error of a scene's reference itself, of which errors must be a multiple to be judged.
  const ownError = (scene, group) => number(stepbench.floor(scene, { ...stepbench.question, group }) / data.trust);
  // The reason for which a question has no answer on a scene.
  const unjudged = (scene, { group, target }) => data.scenes[scene].groups.includes(group)
    ? `${target} cannot be judged on this scene: the reference's own error in ${data.group_names[group]} is ` +
      `${ownError(scene, group)}, more than a hundredth of it.`
    : data.scenes[scene].groups.length ? `This scene has no ${data.group_names[group]}.` : "No run of this scene reached the end.";

  Object.assign(stepbench, {
    to, head, part, wrong, columns, fill, shape, colour, badge, cut, room, tip,
    number, costText, costTick, costWithUnit, multiple, times, quotient, violation, ownError, unjudged,
  });
})();
