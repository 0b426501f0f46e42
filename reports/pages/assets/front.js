// The front page: answer, standings, a chart per scene, heat table, and the profile over all accuracies.
"use strict";
(() => {
  const { html, svg, button, data, part, columns, fill } = stepbench;
  const card = document.getElementById("answer"), place = document.getElementById("profile");
  if (!card) return;

  const MOST = 5;
  let folded = true;
  const standings = (rows, of) => {
    const mine = stepbench.question.highlight, table = document.getElementById("standings");
    const shown = folded ? rows.filter(([m], k) => k < MOST || data.methods[m].label === mine) : rows, rest = rows.length - shown.length;
    const lines = shown.map(([m, alone, tied, reached, tried]) => {
      const method = data.methods[m], parts = [["reached", reached], ["tied", alone + tied], ["alone", alone]];
      const track = html("span", { class: "track", "aria-hidden": "true", style: `--own: ${stepbench.colour(method)}` },
        ...parts.map(([name, n]) => html("i", { class: name, style: `width: ${100 * n / Math.max(of, 1)}%` })));
      return html("tr", { class: method.label === mine && "mine" }, stepbench.head(method),
        html("td", {}, track), html("td", {}, alone), html("td", {}, tied),
        html("td", { title: `reached on ${reached} of ${tried} scenes tried` }, `${reached}`, html("small", {}, ` of ${tried}`)));
    });
    if (rest > 0 || !folded) lines.push(html("tr", {}, html("td", { colspan: 5 },
      button({ class: "more", click() { folded = !folded; standings(rows, of); } }, folded ? `${rest} more` : "fewer"))));
    const heads = columns("method", "alone", "tied", "reached");
    heads.firstChild.after(html("td"));
    const scenes = `${of} ${of === 1 ? "scene" : "scenes"}${of < stepbench.chosen().length ? " that can be judged" : ""}`;
    const none = stepbench.chosen().map((k) => stepbench.answer()[k]).filter((own) => own && !own.reached).length;
    fill(table, `Cheapest by ${data.cost_words[stepbench.question.cost]}, alone or tied, and reached, of ${scenes}${none ? `, ${none} of them reached by none` : ""}`, [heads], lines);
  };
  stepbench.onChange((question) => {
    document.querySelector("main h1").replaceChildren(`Which integrator, for an error in the ${data.group_names[question.group].replace(/ \S+$/, "")} of at most `,
      html("span", { style: "white-space: nowrap" }, `${question.target}?`));
    const open = card.querySelector("details")?.open, here = stepbench.answer(), mine = data.methods.findIndex((m) => m.label === question.highlight), own = stepbench.wrong("methods", mine);
    own[0]?.prepend(part(stepbench.methodRef(mine)), ": ");
    const line = (name, ...parts) => html("p", { class: name }, ...parts.map(part)), [wrong, ...which] = stepbench.wrong("filters", question.scenes);
    const worst = stepbench.violation(question) ? "of the worst constraint, relative to the change that positions and velocities of their size make"
      : "of the worst component, relative to its natural size, or else to its largest value in the reference";
    const beside = data.both.filter((cost) => data.both.includes(question.cost) && cost !== question.cost), rows = stepbench.standings(question);
    const nowhere = rows.filter(([, , , reached]) => !reached).map(([m]) => [stepbench.methodRef(m)]), all = question.scenes === "all";
    const avoid = nowhere.length && nowhere.length < rows.length ? [line(all ? null : "also", "Reached on none of these scenes by ", ...stepbench.listed(nowhere), ".")] : [];
    card.replaceChildren(line("headline", html("small", {}, `${data.least[question.cost]}: `), ...stepbench.headline(question)),
      ...beside.map((cost) => line("also", `${data.least[cost]}: `, ...stepbench.headline({ ...question, cost }, question))),
      ...(all ? [] : avoid), ...(own.length ? own : wrong ? [wrong] : []),
      html("details", { open: open && "" }, html("summary", {}, "costs, rivals, constraints, and where it fails"), ...which, ...(all ? avoid : []),
        line(null, `To ${question.target} in ${data.group_names[question.group]} (${stepbench.norm()}), scene by scene:`),
        ...stepbench.chosen().map((k) => [k, data.scenes[k]]).map(([k, { id, name, page }]) =>
          line(null, { kind: "scene", key: id, text: name, page }, ": ", ...stepbench.verdict(k, question))),
        line("note", `Error: ${worst}, ${stepbench.norm()}. Tied: ${data.ties[question.cost]}, or among the cheapest from a later start of the motion.`)));
    standings(rows, stepbench.chosen().filter((k) => here[k]).length);
  });

  // ---- one chart per chosen scene, with its picture; one of them may be large ----
  const panels = document.getElementById("panels");
  let broad = 0, large = null, wide = innerWidth;
  const picture = (lines) => svg("svg", { class: "picture", viewBox: "-6 -6 112 112", width: 38, height: 38, "aria-hidden": "true" },
    ...lines.map((line) => svg("path", { d: "M" + line.map((p) => p.join(" ")).join("L") })));
  const cards = data.scenes.map((scene, index) => {
    const own = { index, place: html("div", { class: "chart" }) };
    own.button = button({
      class: "enlarge", "aria-expanded": "false", "aria-label": `large chart: ${scene.name}`, title: "large chart; Escape closes it",
      click: () => enlarge(own === large ? null : own),
    }, "⤢");
    const words = html("div", {}, html("h3", { title: scene.id }, stepbench.to(scene.page, {}, scene.name)), html("p", { title: scene.about }, scene.about || "\u00a0"));
    own.card = html("article", { class: "panel" }, html("header", {}, picture(scene.picture), words, own.button), own.place);
    return own;
  });
  const choose = () => {
    for (const { card, index } of cards) card.hidden = !stepbench.chosen().includes(index);
    // All panels but a large one are equally wide: measured once, before the first is drawn.
    broad = cards.find((own) => !own.card.hidden && own !== large)?.place.clientWidth;
  };
  const draw = (own) => own.card.hidden || stepbench.draw(own.place, own.index, own === large ? { large: true } : { wide: broad });
  const enlarge = (wanted) => {
    const changed = [large, wanted].filter(Boolean);
    large = wanted;
    for (const own of changed) {
      own.card.classList.toggle("enlarged", own === large);
      own.button.setAttribute("aria-expanded", own === large);
      draw(own);
    }
    changed.at(-1).button.focus();
    changed.at(-1).card.scrollIntoView({ block: "nearest" });
  };
  window.addEventListener("keydown", (event) => { if (event.key === "Escape" && large) enlarge(null); });
  panels.append(...cards.map(({ card }) => card));

  // The legend of all methods hides and shows them in all charts.
  const alike = Map.groupBy(data.methods, (method) => method.family), alone = ({ family }) => alike.get(family).length < 2;
  const families = Map.groupBy(data.methods.keys(), (m) => alone(data.methods[m]) ? "others" : data.methods[m].family);
  const entry = (places, title, ...content) => button({ class: "switch", "aria-pressed": "true", "data-method": places.join(" "), title }, ...content);
  panels.after(html("div", { class: "chooser", role: "group", "aria-label": "Methods in the charts" }, entry([...data.methods.keys()], null, "all methods"),
    ...[...families].sort(([name, one], [other, two]) => (name === "others") - (other === "others") || two.length - one.length).map(([family, own]) => html("span", {},
      ...(own.length > 1 ? [entry(own, null, `${family}:`)] : []),
      ...own.map((m) => entry([m], data.methods[m].family, stepbench.badge(data.methods[m]), data.methods[m].short))))));
  stepbench.onChange(choose);
  for (const own of cards) stepbench.onChange(() => draw(own));

  // ---- heat table: cost as a multiple of the cheapest, methods by rank and scenes by kind ----
  const STATES = {
    far: ["–", "runs reached the end, none reached the accuracy"],
    failed: ["✕", "no run reached the end"],
    unknown: ["?", "the accuracy is reached at a cost that was not measured"],
    unjudged: ["·", "cannot be judged"],
    untried: ["", "not tried"],
  };
  // The cell with most colour is the cheapest; from this multiple on it has the least.
  const PALE = 100;
  // The scenes by kind, or all of a chosen set together.
  const grouped = (chosen) => {
    const { id, name } = data.filters.find((filter) => filter.id === stepbench.question.scenes);
    const kinds = data.kinds.map((kind) => [kind, chosen.filter((k) => data.scenes[k].kind === kind)]).filter(([, own]) => own.length);
    return id === "all" && kinds.length > 1 ? kinds : [[name, chosen]];
  };
  const cell = (m, index, starts, { cost: by }) => {
    const scene = data.scenes[index], own = stepbench.answer()[index], runs = stepbench.runsOf(index, m);
    const known = own?.states[m] ?? (runs && !own ? "unjudged" : "untried"), reached = Array.isArray(known), state = reached ? "reached" : known;
    const [ratio, k, cost] = reached ? known : [], near = 1 - Math.min(Math.max(Math.log(ratio), 0) / Math.log(PALE), 1);
    const lines = [`${data.methods[m].short} on ${scene.name}`, reached ? `${stepbench.multiple(ratio)} times the cheapest`
      : state === "unjudged" ? stepbench.unjudged(index, stepbench.question) : STATES[state][1]];
    if (cost > 0) lines.push(`${stepbench.costWithUnit(cost, by)} at ${runs.resolutions[k]}`);
    const show = (event) => {
      const box = event.target.getBoundingClientRect();
      stepbench.tip.show(lines, box.right - 10, box.top);
    };
    const looks = `${state}${reached && own.first.includes(m) ? " first" : ""}${starts ? " start" : ""}`;
    const { hide } = stepbench.tip, hints = { "aria-label": lines.join(": "), pointerenter: show, focus: show, pointerleave: hide, blur: hide };
    return html("td", { class: looks, style: reached && `--near: ${Math.round(8 + 92 * near)}%` },
      stepbench.to(scene.page, hints, reached ? stepbench.times(ratio) : STATES[state][0]));
  };
  stepbench.onChange((question) => {
    const groups = grouped(stepbench.chosen()), ranked = stepbench.standings(question).map(([m]) => m);
    const each = (make) => groups.flatMap(([, own]) => own.map((k, n) => make(k, !n)));
    const names = each((k, starts) => html("th", { scope: "col", class: starts ? "start" : "" },
      html("span", {}, stepbench.to(data.scenes[k].page, { title: data.scenes[k].id }, data.scenes[k].name))));
    const kinds = groups.map(([name, own]) => html("th", { colspan: own.length, scope: "colgroup" }, name));
    const error = `an error of ${question.target} in ${data.group_names[question.group]} (${stepbench.norm()})`;
    fill(document.getElementById("heat"), `Cost in ${stepbench.costName(question)} to ${error}, as a multiple of the cheapest on the scene`,
      [html("tr", {}, html("td"), ...kinds), html("tr", {}, html("th", { scope: "col" }, "method"), ...names)],
      (ranked.length ? ranked : [...data.methods.keys()]).map((m) => html("tr", { class: data.methods[m].label === question.highlight && "mine" },
        stepbench.head(data.methods[m]), ...each((k, starts) => cell(m, k, starts, question)))));
  });
  const samples = { reached: ["1.0", "multiple of the cheapest: the more colour, the cheaper; bold: the cheapest, or tied with it"], ...STATES };
  document.getElementById("heat-legend").append(...Object.entries(samples).map(([state, [sign, meaning]]) => html("span", {},
    html("i", { class: state, "aria-hidden": "true", style: "--near: 100%" }, sign), meaning)));

  // ---- profile: part of all pairs of a scene and an accuracy solved within a multiple of the best ----
  const menu = document.getElementById("profile-of"), multiples = Array.from({ length: 31 }, (_, k) => 10 ** (k / 10)), widest = multiples.at(-1);
  // How many pairs of a chosen scene and an accuracy there are, and lines: the part of all pairs that
  // a method, or the best of a family, solves within each multiple.
  stepbench.profile = (question) => {
    const by = menu.value === "families" ? (m) => data.methods[m].family : (m) => m, own = new Map();
    let pairs = 0;
    for (const target of data.targets.filter((said) => said.startsWith("1e"))) for (const k of stepbench.chosen()) {
      const scene = stepbench.answer({ ...question, target })[k];
      if (!(scene?.order.length > 1)) continue;
      pairs += 1;
      for (const [key, methods] of Map.groupBy(scene.order, by))
        own.set(key, [...own.get(key) || [], Math.min(...methods.map((m) => Array.isArray(scene.states[m]) ? scene.states[m][0] : Infinity))]);
    }
    const lines = [...own].sort(([one], [two]) => one - two || 0).map(([key, ratios]) => {
      const places = menu.value === "families" ? null : key, method = data.methods[places ?? families.get(key)[0]];
      const parts = multiples.map((most) => ratios.filter((ratio) => ratio <= most * 1.00005).length / pairs);
      return { name: places === null ? key : method.short, method, places, parts };
    });
    return { pairs, lines };
  };
  const profile = (question) => {
    const { pairs, lines } = stepbench.profile(question), room = Math.max(320, place.clientWidth), narrow = room < 520, high = 400;
    if (!pairs) return place.replaceChildren(html("p", {}, "No pair of scene and target can be judged."));
    lines.sort((a, b) => b.parts.at(-1) - a.parts.at(-1) || b.parts[0] - a.parts[0]);
    const inside = { x0: 52, x1: room - (narrow ? 22 : 26 + stepbench.room(lines.map((line) => line.name))), y0: 12, y1: high - 44, low: high - 6 };
    const onX = (m) => inside.x0 + Math.log(m) / Math.log(widest) * (inside.x1 - inside.x0);
    const onY = (share) => inside.y1 - share * (inside.y1 - inside.y0);
    const best = lines[0], first = [...lines].sort((a, b) => b.parts[0] - a.parts[0])[0], percent = (share) => `${Math.round(100 * share)} %`;
    const said = `Cheapest most often: ${first.name} ${percent(first.parts[0])}; reaches most within ${widest} times the least cost: ` +
      `${best.name} ${percent(best.parts.at(-1))}.`;
    const spoken = `Performance profile over ${pairs} pairs of scene and target. ${said}`;
    const chart = stepbench.frame(room, high, " profile", lines.length, { role: "img", "aria-label": spoken });
    const ticks = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].filter((_, k) => !narrow || k % 3 === 0);
    chart.append(...stepbench.axes(inside, ticks.map((m) => [onX(m), `${m}×`]), [0, .25, .5, .75, 1].map((share) => [onY(share), percent(share)]),
      room < 700 ? `multiple of the least ${data.cost_words[question.cost]} (${pairs} pairs)`
        : `at most so many times the least ${stepbench.costName(question)} (${pairs} pairs that can be judged)`));
    lines.forEach((line, rank) => {
      const points = line.parts.map((share, k) => ({ x: onX(multiples[k]), y: onY(share) }));
      line.kind = stepbench.kindOf(line.method, line === first || line === best);
      line.end = points.at(-1);
      chart.append(stepbench.curve(line, points.map(({ x, y }, k) => k ? `H${x.toFixed(1)}V${y.toFixed(1)}` : `M${x} ${y}`).join(""),
        svg("path", { class: "marks", d: stepbench.marks(line.method, points.filter((_, k) => k % 6 === rank % 6), 3.2) }),
        svg("title", {}, `${line.name}: cheapest on ${percent(line.parts[0])}, reached within ${widest} times on ${percent(line.parts.at(-1))}`)));
    });
    if (!narrow) chart.append(stepbench.legend(lines, inside, false));
    stepbench.hide(chart);
    place.replaceChildren(chart, html("p", { class: "note" }, said));
  };
  menu.addEventListener("change", () => profile(stepbench.question));
  stepbench.onChange(profile);

  window.addEventListener("resize", () => {
    profile(stepbench.question);
    if (Math.abs(innerWidth - wide) < 20) return;
    wide = innerWidth;
    choose();
    cards.forEach(draw);
  });
})();
