// Performance profile: part of all (scene, target) pairs solved within a multiple of the best.
"use strict";
(() => {
  const { svg, html, data } = stepbench;
  const place = document.getElementById("profile"), menu = document.getElementById("profile-of");
  if (!place) return;
  const LEFT = 52, TOP = 12, BOTTOM = 44, HIGH = 400;

  const multiples = Array.from({ length: 31 }, (_, k) => 10 ** (k / 10));

  // How many pairs of a chosen scene and an accuracy there are, and lines: the part of all pairs that
  // a method, or the best of a family, solves within each multiple.
  const profile = (question) => {
    const families = menu.value === "families", own = new Map();
    let pairs = 0;
    for (const target of data.targets.filter((text) => text.startsWith("1e"))) for (const k of stepbench.chosen()) {
      const scene = stepbench.answer({ ...question, target })[k], best = new Map();
      if (!scene?.several) continue;
      pairs += 1;
      for (const m of scene.order) {
        const state = scene.states[m], key = families ? data.methods[m].family : m;
        best.set(key, Math.min(best.get(key) ?? Infinity, Array.isArray(state) ? state[0] : Infinity));
      }
      for (const [key, ratio] of best) own.set(key, [...own.get(key) || [], ratio]);
    }
    const lines = [...own].sort(([one], [two]) => one - two || 0).map(([key, ratios]) => {
      const method = families ? data.methods.find((one) => one.family === key) : data.methods[key], name = families ? key : method.short;
      return { name, method, parts: multiples.map((most) => ratios.filter((ratio) => ratio <= most * 1.00005).length / pairs) };
    });
    return { pairs, lines };
  };
  stepbench.profile = profile;

  const draw = (question) => {
    const { pairs, lines } = profile(question);
    const wide = Math.max(320, place.clientWidth), narrow = wide < 520;
    if (!pairs) {
      place.replaceChildren(html("p", {}, "No pair of scene and target can be judged."));
      return;
    }
    const top = Math.log(multiples.at(-1));
    lines.sort((a, b) => b.parts.at(-1) - a.parts.at(-1) || b.parts[0] - a.parts[0]);
    const right = narrow ? 12 : 26 + stepbench.room(lines.map((line) => line.name));
    const onX = (m) => LEFT + Math.log(m) / top * (wide - LEFT - right);
    const onY = (part) => HIGH - BOTTOM - part * (HIGH - BOTTOM - TOP);
    const best = lines[0], first = [...lines].sort((a, b) => b.parts[0] - a.parts[0])[0];
    const say = (line, part) => `${line.name} ${Math.round(100 * part)} %`;
    const said = `Cheapest most often: ${say(first, first.parts[0])}; reaches most within ${multiples.at(-1)} times the least cost: ${say(best, best.parts.at(-1))}.`;
    const chart = svg("svg", {
      class: `plot profile${question.highlight ? " field" : ""}${lines.length > 16 ? " many" : ""}`, viewBox: `0 0 ${wide} ${HIGH}`, width: wide, height: HIGH, role: "img",
      "aria-label": `Performance profile over ${pairs} pairs of scene and target. ${said}`,
    });
    const grid = svg("g", { class: "grid" }), axis = svg("g", { class: "axis" });
    for (const part of [0, .25, .5, .75, 1]) {
      grid.append(svg("path", { d: `M${LEFT} ${onY(part)}H${wide - right}` }));
      axis.append(svg("text", { x: LEFT - 6, y: onY(part) + 4, "text-anchor": "end" }, `${100 * part} %`));
    }
    for (const m of [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].filter((n, k) => n <= multiples.at(-1) && (!narrow || k % 3 === 0))) {
      grid.append(svg("path", { d: `M${onX(m)} ${TOP}V${onY(0)}` }));
      axis.append(svg("text", { x: onX(m), y: onY(0) + 16, "text-anchor": "middle" }, `${m}×`));
    }
    axis.append(svg("text", { class: "title", x: (LEFT + wide - right) / 2, y: HIGH - 6, "text-anchor": "middle" },
      narrow ? `multiple of the least ${data.cost_words[question.cost]} (${pairs} pairs)`
        : `at most so many times the least ${stepbench.costName(question)} (${pairs} pairs of scene and accuracy)`));
    chart.append(grid, axis);
    const names = svg("g", { class: "legend" });
    let next = TOP;
    lines.forEach((line, rank) => {
      const kind = line.method.label === question.highlight ? "mine" : line === first || line === best ? "first" : "other";
      const own = menu.value === "methods" ? { "data-method": data.methods.indexOf(line.method) } : {};
      const group = svg("g", { class: `curve ${kind}`, ...own });
      group.style.setProperty("--own", stepbench.colour(line.method));
      const d = line.parts.map((part, k) => k ? `H${onX(multiples[k]).toFixed(1)}V${onY(part).toFixed(1)}` : `M${LEFT} ${onY(part)}`).join("");
      const marks = line.parts.map((part, k) => k % 6 === rank % 6 ? `M${onX(multiples[k])} ${onY(part)}${stepbench.shape(line.method, 3.2)}` : "").join("");
      group.append(svg("path", { class: "line", d, ...(line.method.dash[1] > 0 && { "stroke-dasharray": line.method.dash.join(" ") }) }), svg("path", { class: "marks", d: marks }), svg("title", {}, `${line.name}: cheapest on ${Math.round(100 * line.parts[0])} %, reached within ${multiples.at(-1)} times on ${Math.round(100 * line.parts.at(-1))} %`));
      chart.append(group);
      const y = Math.max(next, onY(line.parts.at(-1)));
      if (narrow || y > HIGH - BOTTOM + 20) return;
      next = y + 14;
      const name = svg("text", { class: "name", x: wide - right + 18, y: y + 4, ...own }, stepbench.cut(line.name));
      name.style.fill = stepbench.colour(line.method);
      names.append(svg("path", { class: "leader", ...own, d: `M${wide - right + 1} ${onY(line.parts.at(-1))}L${wide - right + 14} ${y}` }), name);
    });
    chart.append(names);
    stepbench.hide(chart);
    place.replaceChildren(chart, html("p", { class: "note" }, said));
  };
  menu.addEventListener("change", () => draw(stepbench.question));
  stepbench.onChange(draw);
  window.addEventListener("resize", () => draw(stepbench.question));
})();
