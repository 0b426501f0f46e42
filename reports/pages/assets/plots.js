// Work-precision charts: error up, cost to the right, on one scene.
"use strict";
(() => {
  const { svg, html, data } = stepbench;
  const SMALL = { high: 240, left: 46, right: 14, top: 20, bottom: 34, mark: 2.6, ticks: 5 };
  const LARGE = { high: 484, left: 64, right: 0, top: 22, bottom: 48, mark: 4.2, ticks: 10 };
  // Runs without a place on the axes stand in bands above them: those that failed, and those with errors above
  // this, so that a wild run does not press the others flat.
  const MOST = 100;
  const BANDS = [["failed", (p) => p.failed], [`> ${MOST}`, (p) => !p.failed && p.error > MOST && p.cost > 0]], BAND = 15;
  // Errors that are so many times smaller than what the reference can judge are drawn at the lower one.
  const BELOW = 30;

  // Methods that the reader has hidden, while the page is open. Nodes of a method, in charts and
  // legends, have its place as data-method; the switch of several methods has all places.
  const off = new Set();
  const placesOf = (node) => node.dataset.method.split(" ").map(Number);
  stepbench.hide = (root) => {
    for (const node of root.querySelectorAll("[data-method]")) {
      const hidden = placesOf(node).every((m) => off.has(m));
      node.classList.toggle("off", hidden);
      if (node.matches(".switch")) node.setAttribute("aria-pressed", !hidden);
    }
  };
  // A click hides or shows; a second one at once, or one with Shift, shows these alone.
  document.addEventListener("click", (event) => {
    const node = event.target.closest(".switch");
    if (!node) return;
    const own = placesOf(node), alone = event.detail > 1 || event.shiftKey, show = alone || own.some((m) => off.has(m));
    if (alone) data.methods.forEach((_, m) => off.add(m));
    for (const m of own) off[show ? "delete" : "add"](m);
    stepbench.hide(document);
  });

  // All runs of a scene as points; failed runs keep their cost only.
  const pointsOf = (scene, { group, cost }) => data.runs_of[scene].map((runs) => {
    const errors = stepbench.columnOf(runs, group), costs = stepbench.columnOf(runs, cost);
    const points = [];
    for (let k = 0; k < runs.resolutions.length; k++) {
      const ending = stepbench.endingOf(runs, k);
      if (!data.not_tried.includes(ending)) points.push({
        k, ending, failed: ending !== "ok", resolution: stepbench.resolutionOf(runs, k),
        error: errors ? errors[k] : NaN, cost: costs ? costs[k] : NaN,
      });
    }
    return { method: data.methods[runs.method], index: runs.method, points };
  }).filter((curve) => curve.points.length);

  // Powers of ten in a range, so many at most.
  const decades = ([low, high], most) => {
    const first = Math.ceil(low - 1e-9), last = Math.floor(high + 1e-9);
    const step = Math.max(1, Math.ceil((last - first + 1) / most));
    return Array.from({ length: last - first + 1 }, (_, k) => first + k).filter((n) => n % step === 0);
  };
  const ticksOf = (range, most) => {
    const found = decades(range, most).map((n) => 10 ** n);
    if (found.length > 2) return found;
    const [low, high] = range.map((n) => 10 ** n), finer = [];
    for (let n = Math.floor(range[0]); n <= range[1]; n++)
      for (const digit of [1, 2, 5]) if (digit * 10 ** n >= low && digit * 10 ** n <= high) finer.push(digit * 10 ** n);
    return finer.filter((_, k) => k % Math.ceil(finer.length / most) === 0);
  };
  const range = (values, room) => {
    let low = Infinity, high = -Infinity;
    for (const value of values) {
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
    if (low > high) [low, high] = [1, 10];
    [low, high] = [Math.log10(low), Math.log10(high)];
    const more = Math.max(room * (high - low), .15);
    return [low - more, high + more];
  };

  // Where points are on the chart; ``null`` axes of a chart without points.
  const layoutOf = (curves, size, wide, question, floor) => {
    const ok = curves.flatMap((curve) => curve.points.filter((p) => p.error > 0 && p.cost > 0));
    const errors = ok.filter((p) => p.error > 1e-35 && p.error <= MOST).map((p) => Math.max(p.error, (floor || 0) / BELOW));
    const bands = BANDS.filter(([, own]) => curves.some((curve) => curve.points.some(own)));
    const y = range([...errors, Number(question.target)], .05);
    const x = range(ok.map((p) => p.cost).filter((cost) => cost > 1e-35), .04);
    const inside = { x0: size.left, x1: wide - size.right, y0: size.top + BAND * bands.length, y1: size.high - size.bottom };
    const onX = (cost) => inside.x0 + (Math.log10(cost) - x[0]) / (x[1] - x[0]) * (inside.x1 - inside.x0);
    const onY = (error) => inside.y1 - (Math.log10(error) - y[0]) / (y[1] - y[0]) * (inside.y1 - inside.y0);
    const between = (value, low, high) => Math.max(low, Math.min(high, value));
    let unknown = 0;  // runs whose cost is not known stand side by side at the left of their band
    for (const { points } of curves) for (const p of points) {
      const band = bands.findIndex(([, own]) => own(p));
      p.banded = band >= 0;
      p.shown = p.failed || (p.cost > 0 && p.error > 0);
      p.x = p.cost > 0 ? between(onX(p.cost), inside.x0, inside.x1) : inside.x0 + 4 + 7 * unknown++ % (inside.x1 - inside.x0);
      p.y = p.banded ? size.top + BAND * (band + .5) : between(onY(p.error), inside.y0, inside.y1);
    }
    return { x, y, inside, bands: bands.map(([name]) => name), onX, onY, floor: floor && Math.log10(floor) > y[0] ? onY(Math.min(floor, 10 ** y[1])) : null };
  };

  const grid = (at, size, question) => {
    const { inside, onX, onY } = at, lines = svg("g", { class: "grid" }), texts = svg("g", { class: "axis" });
    at.bands.forEach((name, k) => {
      const top = size.top + BAND * k;
      lines.append(svg("rect", { class: "band", x: inside.x0, y: top + 1, width: inside.x1 - inside.x0, height: BAND - 2 }));
      texts.append(svg("text", { x: inside.x0 - 6, y: top + 11, "text-anchor": "end" }, name));
    });
    for (const error of ticksOf(at.y, size.ticks)) {
      const y = onY(error);
      lines.append(svg("path", { d: `M${inside.x0} ${y}H${inside.x1}` }));
      texts.append(svg("text", { x: inside.x0 - 6, y: y + 4, "text-anchor": "end" }, error.toExponential(0).replace("e+", "e")));
    }
    let last = -Infinity;
    for (const cost of ticksOf(at.x, size.ticks)) {
      const x = onX(cost), text = stepbench.costTick(cost, question.cost);
      lines.append(svg("path", { d: `M${x} ${inside.y0}V${inside.y1}` }));
      if (x - last < 7 * text.length + 8) continue;
      last = x;
      texts.append(svg("text", { x, y: inside.y1 + 15, "text-anchor": "middle" }, text));
    }
    texts.append(svg("text", { class: "title", x: (inside.x0 + inside.x1) / 2, y: size.high - 4, "text-anchor": "middle" }, stepbench.costName(question)));
    texts.append(svg("text", { class: "title", x: 2, y: size.top - 8 }, `error in ${data.group_names[question.group].split(" ").at(-1)}`));
    return [lines, texts];
  };

  const curve = ({ method, index, points, kind }, size) => {
    const ok = points.filter((p) => p.shown && !p.failed), failed = points.filter((p) => p.shown && p.failed);
    const mark = size.mark * (kind === "first" ? 1.35 : 1);
    const group = svg("g", { class: `curve ${kind}`, "data-method": index });
    group.style.setProperty("--own", stepbench.colour(method));
    const line = svg("path", { class: "line", d: ok.filter((p) => !p.banded).map((p, k) => `${k ? "L" : "M"}${p.x.toFixed(1)} ${p.y.toFixed(1)}`).join("") });
    if (method.dash[1] > 0) line.setAttribute("stroke-dasharray", method.dash.join(" "));
    const marks = (own) => own.map((p) => `M${p.x.toFixed(1)} ${p.y.toFixed(1)}${stepbench.shape(method, mark)}`).join("");
    group.append(line, svg("path", { class: "marks", d: marks(ok) }));
    if (failed.length) group.append(svg("path", { class: "marks open", d: marks(failed) }));
    return group;
  };

  // Points on the way from one to another, 8 px apart.
  const steps = (p, q) => {
    const count = Math.ceil(Math.hypot(q.x - p.x, q.y - p.y) / 8) || 1;
    return Array.from({ length: count }, (_, k) => ({ x: p.x + k / count * (q.x - p.x), y: p.y + k / count * (q.y - p.y) }));
  };

  // A place for a text near a point, away from other points and texts.
  const placed = (text, p, at, points, taken) => {
    const wide = 8.8 * text.length, high = 15;
    let best = null;
    for (const far of [9, 16, 26, 44, 70]) for (const [dx, dy] of [[1, -.5], [1, .5], [-1, -.5], [-1, .5], [0, -1], [0, 1]]) {
      const left = p.x + dx * far - (dx < 0 ? wide : dx ? 0 : wide / 2), top = p.y + dy * (far + 4) - high / 2;
      const out = left < at.inside.x0 || left + wide > at.inside.x1 + 8 || top < at.inside.y0 - 4 || top + high > at.inside.y1;
      const hits = points.filter((o) => o.x > left - 3 && o.x < left + wide + 3 && o.y > top - 2 && o.y < top + high + 2).length;
      const over = left < 0 || taken.some((o) => left < o.left + o.wide && o.left < left + wide && top < o.top + o.high && o.top < top + high);
      const cost = hits + far / 15 + (out ? 500 : 0) + (over ? 1000 : 0);
      if (!best || cost < best.cost) best = { left, top, wide, high, cost, far, near: { x: Math.max(left, Math.min(p.x, left + wide)), y: top + high / 2 - dy * 6 } };
    }
    if (best.cost >= 1000) return null;
    taken.push(best);
    return best;
  };
  const label = (method, text, left, y) => {
    const node = svg("text", { class: "name", x: left, y }, text);
    node.style.fill = stepbench.colour(method);
    return node;
  };

  // Names at the right edge, at the ends of their curves and moved apart, as a legend for keys.
  const legend = (drawn, at, wide) => {
    const own = drawn.map((item) => ({ ...item, end: item.points.filter((p) => p.shown && !p.banded).at(-1) }))
      .filter((item) => item.end).sort((one, two) => one.end.y - two.end.y);
    const step = 15, most = Math.floor((at.inside.y1 - at.inside.y0) / step) + 1;
    const shown = own.length > most ? own.filter((item) => item.kind === "first" || item.kind === "mine").concat(
      own.filter((item) => item.kind !== "first" && item.kind !== "mine")).slice(0, most - 1).sort((a, b) => a.end.y - b.end.y) : own;
    let next = at.inside.y0;
    for (const item of shown) next = (item.at = Math.max(next, item.end.y)) + step;
    let least = at.inside.y1 + (shown.length < own.length ? 0 : step / 2);
    for (const item of [...shown].reverse()) least = (item.at = Math.min(item.at, least)) - step;
    const group = svg("g", { class: "legend" }), x = at.inside.x1 + 16;
    for (const item of shown) {
      const node = svg("g", { class: "entry switch", tabindex: 0, role: "button", "aria-label": `show ${item.method.short}`, "data-method": item.index });
      node.append(
        svg("path", { class: "leader", d: `M${item.end.x + 4} ${item.end.y}L${x - 4} ${item.at}` }),
        label(item.method, stepbench.cut(item.method.short), x, item.at + 4),
        svg("title", {}, `${item.method.label}: a click hides or shows it, a double click shows it alone`));
      const light = (on) => {
        on &&= !off.has(item.index);
        group.parentNode.classList.toggle("one", on);
        item.node.classList.toggle("lit", on);
      };
      for (const [event, on] of [["pointerenter", true], ["pointerleave", false], ["focus", true], ["blur", false]])
        node.addEventListener(event, () => light(on));
      node.addEventListener("click", () => light(false));
      node.addEventListener("keydown", (event) => {
        if (!["Enter", " "].includes(event.key)) return;
        event.preventDefault();
        node.dispatchEvent(new MouseEvent("click", { bubbles: true, shiftKey: event.shiftKey }));
      });
      group.append(node);
    }
    if (shown.length < own.length) group.append(svg("text", { class: "more", x, y: at.inside.y1 + 16 }, `and ${own.length - shown.length} more`));
    return group;
  };

  // What a chart says, from its data.
  const words = (scene, curves, question, answer) => {
    const failed = curves.reduce((n, c) => n + c.points.filter((p) => p.failed).length, 0);
    const reach = answer ? Object.values(answer.states).filter((state) => Array.isArray(state) || state === "unknown").length : 0;
    const first = answer?.first.map((m) => data.methods[m].short) || [];
    return `${scene.name}: error in ${data.group_names[question.group]} (${stepbench.norm()}) against ${stepbench.costName(question)}, ` +
      `${curves.length} methods, ${curves.reduce((n, c) => n + c.points.length, 0)} runs, ${failed} of them failed. ` +
      (!answer ? `${stepbench.unjudged(data.scenes.indexOf(scene), question)} ` : reach ? `${reach} reach ${question.target}; ` : `None reaches ${question.target}. `) +
      (first.length ? `cheapest: ${first.join(", ")}.` : "");
  };

  // Pointer and keys find runs; a click opens the scene's page.
  const listen = (chart, curves, question, size, address) => {
    const points = curves.flatMap((c) => c.points.filter((p) => p.shown).map((p) => ({ ...p, method: c.method, index: c.index })));
    const ring = svg("circle", { class: "found", r: size.mark + 4, visibility: "hidden" });
    chart.append(ring);
    let now = -1;
    const hide = () => {
      ring.setAttribute("visibility", "hidden");
      stepbench.tip.hide();
    };
    const show = (k) => {
      now = k;
      const p = points[k], box = chart.getBoundingClientRect(), scale = box.width / chart.viewBox.baseVal.width;
      ring.setAttribute("cx", p.x);
      ring.setAttribute("cy", p.y);
      ring.setAttribute("visibility", "visible");
      stepbench.tip.show([
        [stepbench.badge(p.method), ` ${p.method.label}`],
        p.resolution,
        p.failed ? `ended with ${p.ending}` : `error ${stepbench.number(p.error)} in ${data.group_names[question.group]}, ${stepbench.norm()}`,
        stepbench.costWithUnit(p.cost, question.cost),
        p.failed ? "it did not reach the end" : "it reached the end",
      ], box.left + scale * p.x, box.top + scale * p.y);
    };
    chart.addEventListener("pointermove", (event) => {
      const box = chart.getBoundingClientRect(), scale = chart.viewBox.baseVal.width / box.width;
      const x = (event.clientX - box.left) * scale, y = (event.clientY - box.top) * scale;
      let best = -1, least = 20 ** 2;
      points.forEach((p, k) => {
        if (off.has(p.index)) return;
        const far = (p.x - x) ** 2 + (p.y - y) ** 2;
        if (far < least) [best, least] = [k, far];
      });
      if (best < 0) hide();
      else show(best);
    });
    chart.addEventListener("pointerleave", hide);
    chart.addEventListener("blur", hide);
    chart.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (event.target !== chart || !points.some((p) => !off.has(p.index))) return;
      if (step) {
        do now = (now + step + points.length) % points.length; while (off.has(points[now].index));
        show(now);
      } else if (["ArrowDown", "ArrowUp"].includes(event.key)) {
        const way = event.key === "ArrowDown" ? 1 : -1, from = points[Math.max(now, 0)].method;
        let k = Math.max(now, 0);
        while (points[k + way] && (points[k].method === from || off.has(points[k].index))) k += way;
        if (!off.has(points[k].index)) show(k);
      } else if (event.key === "Enter" && address) location.href = address;
      else return;
      event.preventDefault();
    });
    if (address) chart.addEventListener("click", () => { location.href = address; });
  };

  // Draw one scene's chart into a place, for the question of the page.
  stepbench.draw = (place, index, { large = false, wide: known = 0 } = {}) => {
    const size = large ? LARGE : SMALL, scene = data.scenes[index], { question } = stepbench;
    if (!scene.groups.includes(question.group)) {
      place.replaceChildren(html("p", { class: "note" }, stepbench.unjudged(index, question)));
      return;
    }
    const wide = Math.max(260, Math.round(known || place.clientWidth || (large ? 900 : 360)));
    const curves = pointsOf(index, question), narrow = large && wide < 560, names = large && !narrow;
    const fits = narrow ? { ...size, right: 14, left: 50, high: 380 }
      : names ? { ...size, right: 26 + stepbench.room(curves.filter((c) => c.points.some((o) => o.error > 0 && o.cost > 0)).map((c) => c.method.short)) } : size;
    const answer = stepbench.answer()[index], floor = stepbench.floor(index);
    const at = layoutOf(curves, fits, wide, question, floor);
    const chart = svg("svg", {
      class: `plot${large ? " large" : ""}${question.highlight ? " field" : ""}${curves.length > 16 ? " many" : ""}`,
      viewBox: `0 0 ${wide} ${fits.high}`, width: wide, height: fits.high,
      role: names ? "group" : "img", tabindex: 0, "aria-label": words(scene, curves, question, answer),
    });
    if (at.floor !== null && at.floor < at.inside.y1) {
      chart.append(svg("rect", { class: "floor", x: at.inside.x0, y: at.floor, width: at.inside.x1 - at.inside.x0, height: at.inside.y1 - at.floor }));
      if (large) chart.append(svg("text", { class: "floor-name", x: at.inside.x0 + 6, y: at.floor + 14 }, `below: within ${data.trust} times ${stepbench.violation(question) ? "rounding" : "the reference's own error"}, ${stepbench.ownError(index, question.group)}`));
    }
    chart.append(...grid(at, fits, question));
    const y = at.onY(Number(question.target));
    chart.append(svg("path", { class: "asked", d: `M${at.inside.x0} ${y}H${at.inside.x1}` }));
    const kindOf = (c) => c.method.label === question.highlight ? "mine" : answer?.first.includes(c.index) ? "first" : "other";
    const rank = { other: 0, first: 1, mine: 2 };
    const drawn = curves.map((c) => ({ ...c, kind: kindOf(c) })).sort((one, two) => rank[one.kind] - rank[two.kind]);
    for (const item of drawn) chart.append(item.node = curve(item, fits));
    const all = curves.flatMap((c) => c.points.filter((p) => p.shown));
    // On the left no line leads to a name; the name of the reference's floor may stand there.
    const beside = at.floor !== null && Math.abs(y - 19 - at.floor) < 16;
    const taken = large ? [{ left: beside ? at.inside.x1 - 84 : at.inside.x0 + 6, top: y - 17, wide: 80, high: 14 }] : [];
    // Names keep away from lines and from the asked accuracy, too.
    const busy = curves.flatMap((c) => c.points.filter((p) => p.shown && !p.banded).flatMap((p, k, own) => steps(p, own[k + 1] || p)))
      .concat(steps({ x: at.inside.x0, y }, { x: at.inside.x1, y }));
    const named = drawn.filter((item) => item.kind !== "other").reverse();
    // All winners have a ring, few a name.
    for (const [k, item] of named.entries()) {
      const own = svg("g", { "data-method": item.index });
      chart.append(own);
      const state = answer?.states[item.index], run = Array.isArray(state) ? item.points[state[1]] : null;
      if (run?.shown) {
        const ring = svg("circle", { class: "winner", cx: run.x, cy: run.y, r: fits.mark + 4 });
        ring.style.stroke = stepbench.colour(item.method);
        own.append(ring);
      }
      const p = run?.shown ? run : item.points.filter((o) => o.shown && !o.banded).at(-1);
      if (k > 2 || !p || (names && !run)) continue;
      const spot = placed(item.method.short, p, at, busy, taken);
      if (spot?.far > 20) own.append(svg("path", { class: "leader", d: `M${p.x} ${p.y}L${spot.near.x} ${spot.near.y}` }));
      if (spot) own.append(label(item.method, item.method.short, spot.left, spot.top + 12));
    }
    if (names) chart.append(legend(drawn, at, wide));
    if (large) chart.append(svg("text", { class: "asked-name", x: beside ? at.inside.x1 - 4 : at.inside.x0 + 6, y: y - 5, "text-anchor": beside ? "end" : "start" }, `asked: ${question.target}`));
    if (!all.some((p) => !p.failed)) chart.append(svg("text", { class: "nothing", x: wide / 2, y: fits.high / 2, "text-anchor": "middle" },
      curves.some((c) => c.points.some((p) => !p.failed)) ? `no ${data.cost_words[question.cost]} known` : curves.some((c) => c.points.length) ? "no run reached the end" : "not run"));
    listen(chart, curves, question, fits, large ? null : stepbench.page(scene.page));
    stepbench.hide(chart);
    place.replaceChildren(chart);
  };

  for (const place of document.querySelectorAll(".chart.large[data-scene]"))
    stepbench.onChange(() => stepbench.draw(place, Number(place.dataset.scene), { large: true }));
})();
