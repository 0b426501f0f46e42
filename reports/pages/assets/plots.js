// Work-precision charts: error up, cost to the right, on one scene; and what all charts of the page share.
"use strict";
(() => {
  const { svg, html, data } = stepbench;
  const SMALL = { high: 240, left: 46, right: 14, top: 20, bottom: 34, mark: 2.6, ticks: 5 };
  const LARGE = { high: 484, left: 64, right: 0, top: 22, bottom: 48, mark: 4.2, ticks: 10 };
  // In bands above the axes stand runs that failed, and errors above this, which would press the others flat.
  const MOST = 100;
  const BANDS = [["failed", (p) => p.failed], [`> ${MOST}`, (p) => !p.failed && p.error > MOST && p.cost > 0]], BAND = 15;
  const FAILED = { shape: "M-1,-.7L-.7,-1L0,-.3L.7,-1L1,-.7L.3,0L1,.7L.7,1L0,.3L-.7,1L-1,.7L-.3,0Z" };
  // Errors that are so many times smaller than what the reference can judge are drawn at the lower one.
  const BELOW = 30;

  // Methods that the reader has hidden. Nodes of a method have its place as data-method, those of several all.
  const hidden = new Set();
  const placesOf = (node) => node.dataset.method.split(" ").map(Number);
  stepbench.hide = (root) => {
    for (const node of root.querySelectorAll("[data-method]")) {
      const off = placesOf(node).every((m) => hidden.has(m));
      node.classList.toggle("off", off);
      if (node.matches(".switch")) node.setAttribute("aria-pressed", !off);
    }
  };
  // A click hides or shows; a second one at once, or one with Shift, shows these alone.
  document.addEventListener("click", (event) => {
    const node = event.target.closest(".switch");
    if (!node) return;
    const own = placesOf(node), alone = event.detail > 1 || event.shiftKey, show = alone || own.some((m) => hidden.has(m));
    if (alone) data.methods.forEach((_, m) => hidden.add(m));
    for (const m of own) hidden[show ? "delete" : "add"](m);
    stepbench.hide(document);
  });

  // ---- what charts share ----
  const text = (x, y, said, more = {}) => svg("text", { x, y, ...more }, said);
  stepbench.frame = (wide, high, looks, count, more) => svg("svg", {
    class: `plot${looks}${stepbench.question.highlight ? " field" : ""}${count > 16 ? " many" : ""}`,
    viewBox: `0 0 ${wide} ${high}`, width: wide, height: high, ...more,
  });
  // Grid and texts of two axes from pairs of a place and a text; texts that would touch are left out.
  stepbench.axes = ({ x0, x1, y0, y1, low }, across, up, title) => {
    const lines = svg("g", { class: "grid" });
    const texts = svg("g", { class: "axis" }, text((x0 + x1) / 2, low, title, { class: "title", "text-anchor": "middle" }));
    for (const [y, said] of up) {
      lines.append(svg("path", { d: `M${x0} ${y}H${x1}` }));
      texts.append(text(x0 - 6, y + 4, said, { "text-anchor": "end" }));
    }
    let last = -Infinity;
    for (const [x, said] of across) {
      lines.append(svg("path", { d: `M${x} ${y0}V${y1}` }));
      if (x - last < 7 * said.length + 8) continue;
      last = x;
      texts.append(text(x, y1 + 15, said, { "text-anchor": "middle" }));
    }
    return [lines, texts];
  };
  const kindOf = (method, first) => method.label === stepbench.question.highlight ? "mine" : first ? "first" : "other";
  const marks = (method, points, r) => points.map(({ x, y }) => `M${x.toFixed(1)} ${y.toFixed(1)}${stepbench.shape(method, r)}`).join("");
  const curve = ({ method, kind, places }, d, ...more) => svg("g",
    { class: `curve ${kind}`, "data-method": places, style: `--own: ${stepbench.colour(method)}` },
    svg("path", { class: "line", d, "stroke-dasharray": method.dash[1] > 0 && method.dash.join(" ") }), ...more);
  const label = (method, said, x, y, more) => text(x, y, said, { class: "name", style: `fill: ${stepbench.colour(method)}`, ...more });
  // Names at the right edge, at the ends of their curves and moved apart; they may be a legend for keys.
  const legend = (items, { x1, y0, y1 }, switches) => {
    const own = items.filter((item) => item.end).sort((one, two) => one.end.y - two.end.y);
    const step = 15, most = Math.floor((y1 - y0) / step) + 1, rest = own.length > most, x = x1 + 16;
    const shown = rest ? [...own.filter((item) => item.kind !== "other"), ...own.filter((item) => item.kind === "other")]
      .slice(0, most - 1).sort((one, two) => one.end.y - two.end.y) : own;
    let next = y0, least = y1 - (rest ? 0 : 2);
    for (const item of shown) next = (item.at = Math.max(next, item.end.y)) + step;
    for (const item of [...shown].reverse()) least = (item.at = Math.min(item.at, least)) - step;
    const entry = (item) => {
      const light = (lit) => {
        group.parentNode.classList.toggle("one", lit);
        item.node.classList.toggle("lit", lit);
      };
      const on = () => light(!hidden.has(item.places)), off = () => light(false);
      return svg("g", switches ? {
        class: "entry switch", tabindex: 0, role: "button", "aria-label": `show ${item.method.short}`, "data-method": item.places,
        pointerenter: on, pointerleave: off, focus: on, blur: off, click: off,
        keydown(event) {
          if (!["Enter", " "].includes(event.key)) return;
          event.preventDefault();
          event.target.dispatchEvent(new MouseEvent("click", { bubbles: true, shiftKey: event.shiftKey }));
        },
      } : { "data-method": item.places },
      svg("path", { class: "leader", d: `M${item.end.x + 4} ${item.end.y}L${x - 4} ${item.at}` }),
      label(item.method, stepbench.cut(item.name), x, item.at + 4),
      svg("title", {}, switches ? `${item.method.label}: a click hides or shows it, a double click shows it alone` : item.name));
    };
    const group = svg("g", { class: "legend" }, ...shown.map(entry));
    if (rest) group.append(text(x + 10, y1 + 16, `and ${own.length - shown.length} more`, { class: "more" }));
    return group;
  };
  Object.assign(stepbench, { curve, marks, kindOf, legend });

  // ---- one scene ----
  // All runs of a scene as points; failed runs keep their cost only.
  const pointsOf = (scene, { group, cost }) => data.runs_of[scene].map((runs) => {
    const errors = stepbench.columnOf(runs, group), costs = stepbench.columnOf(runs, cost);
    const points = runs.resolutions.map((resolution, k) => {
      const ending = runs.endings?.[k] ?? "ok";
      return { resolution, ending, failed: ending !== "ok", index: runs.method, error: errors?.[k] ?? NaN, cost: costs?.[k] ?? NaN };
    }).filter(({ ending }) => !data.not_tried.includes(ending));
    return { method: data.methods[runs.method], places: runs.method, points };
  }).filter((own) => own.points.length);

  // Powers of ten between two logarithms, so many at most; with the digits 2 and 5 where these are few.
  const ticksOf = ([low, high], most) => {
    const ticks = (...digits) => Array.from({ length: Math.floor(high) - Math.floor(low) + 2 }, (_, k) => Math.floor(low) + k)
      .flatMap((n) => digits.map((digit) => digit * 10 ** n))
      .filter((tick) => Math.log10(tick) > low - 1e-9 && Math.log10(tick) < high + 1e-9);
    const decades = ticks(1), step = Math.ceil(decades.length / most), finer = ticks(1, 2, 5);
    const found = decades.filter((tick) => Math.round(Math.log10(tick)) % step === 0);
    return found.length > 2 ? found : finer.filter((_, k) => k % Math.ceil(finer.length / most) === 0);
  };
  // The logarithms of the ends of an axis.
  const range = (values, room) => {
    const [low, high] = values.length ? [Math.min(...values), Math.max(...values)].map(Math.log10) : [0, 1];
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
    const inside = { x0: size.left, x1: wide - size.right, y0: size.top + BAND * bands.length, y1: size.high - size.bottom, low: size.high - 4 };
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

  const steps = (p, q) => {
    const count = Math.ceil(Math.hypot(q.x - p.x, q.y - p.y) / 8) || 1;
    return Array.from({ length: count }, (_, k) => ({ x: p.x + k / count * (q.x - p.x), y: p.y + k / count * (q.y - p.y) }));
  };

  // A place for a text near a point, away from other points and texts.
  const placed = (said, p, at, points, taken) => {
    const wide = 8.8 * said.length, high = 15;
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
  const words = (scene, curves, question, answer) => {
    const failed = curves.reduce((n, c) => n + c.points.filter((p) => p.failed).length, 0);
    const reach = answer ? Object.values(answer.states).filter(stepbench.reaches).length : 0;
    const first = answer?.first.map((m) => data.methods[m].short) || [];
    return `${scene.name}: error in ${data.group_names[question.group]} (${stepbench.norm()}) against ${stepbench.costName(question)}, ` +
      `${curves.length} methods, ${curves.reduce((n, c) => n + c.points.length, 0)} runs, ${failed} of them failed. ` +
      (!answer ? `${stepbench.unjudged(data.scenes.indexOf(scene), question)} ` : reach ? `${reach} reach ${question.target}; ` : `None reaches ${question.target}. `) +
      (first.length ? `cheapest: ${first.join(", ")}.` : "");
  };

  // Pointer and keys find runs; a click opens the scene's page.
  const listen = (chart, points, question, size, address) => {
    const ring = svg("circle", { class: "found", r: size.mark + 4, visibility: "hidden" }), box = () => chart.getBoundingClientRect();
    const scale = () => box().width / chart.viewBox.baseVal.width, seen = () => points.filter((p) => !hidden.has(p.index));
    let now = null;
    const hide = () => { ring.setAttribute("visibility", "hidden"); stepbench.tip.hide(); };
    const show = (p) => {
      now = p;
      for (const [name, value] of [["cx", p.x], ["cy", p.y], ["visibility", "visible"]]) ring.setAttribute(name, value);
      stepbench.tip.show([
        [stepbench.badge(data.methods[p.index]), ` ${data.methods[p.index].label}`],
        p.resolution,
        p.failed ? `ended with ${p.ending}` : `error ${stepbench.number(p.error)} in ${data.group_names[question.group]}, ${stepbench.norm()}`,
        stepbench.costWithUnit(p.cost, question.cost),
      ], box().left + scale() * p.x, box().top + scale() * p.y);
    };
    chart.addEventListener("pointermove", (event) => {
      const x = (event.clientX - box().left) / scale(), y = (event.clientY - box().top) / scale();
      let best = null, least = 20;
      for (const p of seen()) {
        const far = Math.hypot(p.x - x, p.y - y);
        if (far < least) [best, least] = [p, far];
      }
      if (best) show(best);
      else hide();
    });
    for (const end of ["pointerleave", "blur"]) chart.addEventListener(end, hide);
    chart.addEventListener("keydown", (event) => {
      const all = seen(), at = all.indexOf(now), from = Math.max(at, 0);
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key], way = { ArrowDown: 1, ArrowUp: -1 }[event.key];
      if (event.target !== chart || !all.length) return;
      if (step) show(all[(at + step + all.length) % all.length]);
      else if (way) {
        let k = from;
        while (all[k + way] && all[k].index === all[from].index) k += way;
        show(all[k]);
      } else if (event.key === "Enter" && address) location.href = address;
      else return;
      event.preventDefault();
    });
    if (address) chart.addEventListener("click", () => { location.href = address; });
    chart.append(ring);
  };

  stepbench.draw = (place, index, { large = false, wide: known = 0 } = {}) => {
    const scene = data.scenes[index], { question } = stepbench;
    if (!scene.groups.includes(question.group)) return place.replaceChildren(html("p", { class: "note" }, large ? "" : stepbench.unjudged(index, question)));
    const answer = stepbench.answer()[index], floor = stepbench.floor(index), rank = { other: 0, first: 1, mine: 2 };
    const curves = pointsOf(index, question).map((own) =>
      ({ ...own, name: own.method.short, kind: kindOf(own.method, answer?.first.includes(own.places)) }));
    const wide = Math.max(260, Math.round(known || place.clientWidth || (large ? 900 : 360)));
    const narrow = large && wide < 560, names = large && !narrow, size = large ? { ...LARGE } : SMALL;
    if (narrow) Object.assign(size, { right: 14, left: 50, high: 380 });
    if (names) size.right = 26 + stepbench.room(curves.filter((own) => own.points.some((p) => p.error > 0 && p.cost > 0)).map((own) => own.name));
    const at = layoutOf(curves, size, wide, question, floor), { inside } = at;
    const chart = stepbench.frame(wide, size.high, large ? " large" : "", curves.length,
      { role: names ? "group" : "img", tabindex: 0, "aria-label": words(scene, curves, question, answer) }), below = [];
    if (at.floor !== null && at.floor < inside.y1) {
      chart.append(svg("rect", { class: "floor", x: inside.x0, y: at.floor, width: inside.x1 - inside.x0, height: inside.y1 - at.floor }));
      const own = `${stepbench.violation(question) ? "rounding" : "the reference's own error"}, ${stepbench.ownError(index, question.group)}`;
      if (large) below.push(text(inside.x0 + 6, at.floor + 14, `below: within ${data.trust} times ${own}`, { class: "floor-name" }));
    }
    at.bands.forEach((name, k) => chart.append(
      svg("rect", { class: "band", x: inside.x0, y: size.top + BAND * k + 1, width: inside.x1 - inside.x0, height: BAND - 2 }),
      text(inside.x0 - 6, size.top + BAND * k + 11, name, { "text-anchor": "end" })));
    chart.append(...stepbench.axes(inside, ticksOf(at.x, size.ticks).map((cost) => [at.onX(cost), stepbench.costTick(cost, question.cost)]),
      ticksOf(at.y, size.ticks).filter((error) => !at.bands.length || at.onY(error) > inside.y0 + 8).map((error) => [at.onY(error), error.toExponential(0).replace("e+", "e")]), stepbench.costName(question)),
    text(2, size.top - 8, `error in ${data.group_names[question.group].split(" ").at(-1)}`, { class: "title" }));
    const y = at.onY(Number(question.target));
    chart.append(svg("path", { class: "asked", d: `M${inside.x0} ${y}H${inside.x1}` }));
    const drawn = [...curves].sort((one, two) => rank[one.kind] - rank[two.kind]);
    for (const item of drawn) {
      const shown = item.points.filter((p) => p.shown), line = shown.filter((p) => !p.banded), mark = size.mark * (item.kind === "first" ? 1.35 : 1);
      item.end = line.at(-1);
      const marked = (looks, failed) => svg("path", { class: looks, d: marks(failed ? FAILED : item.method, shown.filter((p) => p.failed === failed), mark) });
      item.node = curve(item, line.map((p, k) => `${k ? "L" : "M"}${p.x.toFixed(1)} ${p.y.toFixed(1)}`).join(""),
        marked("marks", false), marked("marks open", true));
      chart.append(item.node);
    }
    const all = curves.flatMap((own) => own.points.filter((p) => p.shown));
    // On the left no line leads to a name; the name of the reference's floor may stand there.
    const beside = at.floor !== null && Math.abs(y - 19 - at.floor) < 16;
    const taken = large ? [{ left: beside ? inside.x1 - 84 : inside.x0 + 6, top: y - 17, wide: 80, high: 14 }] : [];
    // Names keep away from lines and from the asked accuracy, too.
    const busy = curves.flatMap((own) => own.points.filter((p) => p.shown && !p.banded).flatMap((p, k, line) => steps(p, line[k + 1] || p)))
      .concat(steps({ x: inside.x0, y }, { x: inside.x1, y }));
    // All winners have a ring, few a name.
    for (const [k, item] of drawn.filter(({ kind }) => kind !== "other").reverse().entries()) {
      const own = svg("g", { "data-method": item.places }), state = answer?.states[item.places];
      const run = Array.isArray(state) && item.points[state[1]].shown ? item.points[state[1]] : null, p = run || item.end;
      if (run) own.append(svg("circle", { class: "winner", cx: p.x, cy: p.y, r: size.mark + 4, style: `stroke: ${stepbench.colour(item.method)}` }));
      chart.append(own);
      if (k > 2 || !p || (names && !run)) continue;
      const spot = placed(item.name, p, at, busy, taken);
      if (spot?.far > 20) own.append(svg("path", { class: "leader", d: `M${p.x} ${p.y}L${spot.near.x} ${spot.near.y}` }));
      if (spot) own.append(label(item.method, item.name, spot.left, spot.top + 12));
    }
    if (names) chart.append(legend(drawn, inside, true));
    const looks = { class: "asked-name", "text-anchor": beside ? "end" : "start" };
    if (large) chart.append(...below, text(beside ? inside.x1 - 4 : inside.x0 + 6, y - 5, `asked: ${question.target}`, looks));
    const why = !curves.length ? "not run" : curves.every((own) => own.points.every((p) => p.failed)) ? "no run reached the end" : `no ${data.cost_words[question.cost]} known`;
    if (all.every((p) => p.failed)) chart.append(text(wide / 2, size.high / 2, why, { class: "nothing", "text-anchor": "middle" }));
    listen(chart, all, question, size, large ? null : stepbench.page(scene.page));
    stepbench.hide(chart);
    place.replaceChildren(chart);
  };

  for (const place of document.querySelectorAll(".chart.large[data-scene]"))
    stepbench.onChange(() => stepbench.draw(place, Number(place.dataset.scene), { large: true }));
})();
