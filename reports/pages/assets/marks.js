// Marks of methods, SVG elements, numbers in words, and the note beside the pointer.
"use strict";
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const SHAPES = {
    "circle": (r) => `m${-r} 0a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0z`,
    "square": (r) => `m${-.9 * r} ${-.9 * r}h${1.8 * r}v${1.8 * r}h${-1.8 * r}z`,
    "triangle-up": (r) => `m0 ${-1.2 * r}l${1.15 * r} ${2 * r}h${-2.3 * r}z`,
    "triangle-down": (r) => `m0 ${1.2 * r}l${1.15 * r} ${-2 * r}h${-2.3 * r}z`,
    "triangle-right": (r) => `m${1.2 * r} 0l${-2 * r} ${1.15 * r}v${-2.3 * r}z`,
    "triangle-left": (r) => `m${-1.2 * r} 0l${2 * r} ${1.15 * r}v${-2.3 * r}z`,
    "diamond": (r) => `m0 ${-1.3 * r}l${1.2 * r} ${1.3 * r}l${-1.2 * r} ${1.3 * r}l${-1.2 * r} ${-1.3 * r}z`,
    "cross": (r) => `m${-.4 * r} ${-1.2 * r}h${.8 * r}v${.8 * r}h${.8 * r}v${.8 * r}h${-.8 * r}v${.8 * r}h${-.8 * r}v${-.8 * r}h${-.8 * r}v${-.8 * r}h${.8 * r}z`,
  };
  // The other marks are polygons, as a path within -1 to 1.
  const polygon = (path, r) => {
    const points = path.slice(1, -1).split("L").map((p) => p.split(",").map((value) => 1.25 * r * value));
    return points.map(([x, y], k) => k ? `l${x - points[k - 1][0]} ${y - points[k - 1][1]}` : `m${x} ${y}`).join("") + "z";
  };

  const svg = (name, attributes = {}, ...children) => {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  };
  const html = (name, attributes = {}, ...children) => {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  };

  const shape = (method, r) => SHAPES[method.shape]?.(r) ?? polygon(method.shape, r);
  // A colour of a method that follows light and dark; paper is always light.
  const colour = (method) => `light-dark(${method.light}, ${method.dark})`;
  const badge = (method) => {
    const path = svg("path", { d: "M7 7" + shape(method, 4.4) });
    path.style.fill = colour(method);
    return svg("svg", { class: "badge", viewBox: "0 0 14 14", width: 14, height: 14, "aria-hidden": "true" }, path);
  };

  // A link to a page of the report, and the head of a method's row.
  const to = (page, attributes, ...children) => html("a", { ...attributes, href: stepbench.page(page) }, ...children);
  const head = (method) => html("th", { scope: "row" }, badge(method), to(method.page, { title: method.label }, method.short));

  // Three significant digits, as in the tables and sentences (bench/results/table.py).
  const number = (value) => {
    if (value < 1e-35) return "0";
    const rounded = Number(value.toPrecision(3));
    if (rounded >= 1e-4 && value < 1e6) return rounded >= 100 ? rounded.toFixed(0) : String(rounded);
    return rounded.toExponential().replace("e+", "e");
  };
  const PREFIXES = [[1e12, "T"], [1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""]];
  const digits = (value) => value >= 100 ? Math.round(value).toString() : String(Number(value.toPrecision(3)));
  // A cost at a tick of an axis, in few characters with its unit.
  const costTick = (value, cost) => {
    if (value < 1e-35) return "0";
    if (cost === "seconds") {
      const [scale, unit] = value >= 1 ? [1, "s"] : value >= 1e-3 ? [1e3, "ms"] : [1e6, "µs"];
      return `${digits(value * scale)} ${unit}`;
    }
    const [scale, prefix] = PREFIXES.find(([least]) => value >= least * .9995) || [1, ""];
    return `${digits(value / scale)}${prefix ? "\u202f" + prefix : ""}`;
  };
  // A cost as in tables and sentences (reports/formatting.py).
  const costText = (value, cost) => {
    if (cost === "seconds") return value >= 1 ? `${number(value)} s` : `${number(1e3 * value)} ms`;
    const [size, word] = [[1e9, " billion"], [1e6, " million"]].find(([least]) => value >= least) || [1, ""];
    return `${number(value / size)}${word}`;
  };
  const costWithUnit = (value, cost) =>
    cost === "seconds" ? costText(value, cost) : `${costText(value, cost)} ${stepbench.data.units[cost]}`;
  // A ratio with as many digits as tell it from 1, as in sentences.
  const multiple = (ratio) => ratio > 1e35 ? "∞" : ratio >= 1.01 ? number(ratio) : String(Number(ratio.toPrecision(6)));
  // A multiple in a cell with little room.
  const times = (value) => value > 1e35 ? "∞" : value < 10 ? value.toFixed(1) : value < 9999.5 ? value.toFixed(0) : value.toExponential(0).replace("e+", "e");

  // Names in a margin: cut if they are long, and the room that they take.
  const LONGEST = 30;
  const cut = (name) => name.length > LONGEST ? `${name.slice(0, LONGEST - 1)}…` : name;
  const room = (names) => Math.ceil(7.6 * Math.max(6, ...names.map((name) => cut(name).length)));

  // One note for the whole page; screen readers hear it when it comes by keyboard.
  const note = html("div", { class: "tip", role: "status", hidden: "" });
  document.body.append(note);
  const tip = {
    show(lines, x, y) {
      note.replaceChildren(...lines.map((line, k) => {
        const row = html(k ? "span" : "strong");
        row.append(...[line].flat());
        return row;
      }));
      note.hidden = false;
      const { offsetWidth: wide, offsetHeight: high } = note;
      const left = x + 14 + wide > innerWidth ? x - 14 - wide : x + 14;
      note.style.left = `${Math.max(4, left) + scrollX}px`;
      note.style.top = `${Math.max(4, Math.min(y + 12, innerHeight - high - 4)) + scrollY}px`;
    },
    hide() { note.hidden = true; },
  };
  window.addEventListener("keydown", (event) => { if (event.key === "Escape") tip.hide(); });

  // The error of a scene's reference itself, of which errors must be a multiple to be judged.
  const ownError = (scene, group) => number(stepbench.floor(scene, { ...stepbench.question, group }) / stepbench.data.trust);
  // The reason for which a question has no answer on a scene.
  const unjudged = (scene, { group, target }) => stepbench.data.scenes[scene].groups.includes(group)
    ? `${target} cannot be judged on this scene: the reference's own error in ${stepbench.data.group_names[group]} is ` +
      `${ownError(scene, group)}, more than a hundredth of it.`
    : `This scene has no ${stepbench.data.group_names[group]}, or no run of it reached the end.`;

  Object.assign(stepbench, { svg, html, to, head, shape, colour, badge, costText, costTick, costWithUnit, multiple, number, times, tip, cut, room, ownError, unjudged });
})();
