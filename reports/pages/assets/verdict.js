// The verdict on one scene in words, and a table of its methods: what the asked accuracy costs each.
"use strict";
(() => {
  const { html, data } = stepbench;
  // A part of a sentence is text, or the place of a reference to something in the report.
  const part = (item) => {
    if (typeof item === "string") return item;
    const method = item.kind === "method" && data.methods.find((m) => m.label === item.key);
    const text = item.text || item.key;
    const node = item.page ? stepbench.to(item.page, { class: item.kind, title: item.key }, text) : html("span", { class: item.kind, title: item.key }, text);
    if (method) node.style.color = `color-mix(in oklab, ${stepbench.colour(method)} 70%, var(--ink))`;
    return node;
  };
  stepbench.part = part;

  const STATES = {
    far: "not reached", failed: "no run reached the end", unknown: "reached, cost not measured", refused: "the method does not take the scene",
  };
  // So many winners are named.
  const MOST = 3;

  const runsOf = (scene, index) => data.runs_of[scene].find((own) => own.method === index);
  // The run of the least error of all on a scene, or of one method: its method, place and error.
  const nearest = (scene, question, only) => {
    let best = null;
    for (const runs of only === undefined ? data.runs_of[scene] : [runsOf(scene, only)]) stepbench.columnOf(runs, question.group)?.forEach((error, k) => {
      if (error > 0 && !(best?.error <= error)) best = { index: runs.method, k, error };
    });
    return best;
  };
  // The run of the verdict that stands first there, or none.
  const winner = (own) => {
    const index = own?.first[0], state = own?.states[index];
    return Array.isArray(state) ? { index, k: state[1] } : null;
  };
  const joined = (items) => items.flatMap((item, k) => [...(k ? [k < items.length - 1 ? ", " : " and "] : []), ...item]);
  // What speaks against a winner: it ties from a later start alone, or its accelerations are wrong.
  const marks = (scene, own, m, { group }) => [[own.later.includes(m), data.later], [group !== "a" && data.scenes[scene].wrong_a.includes(m), data.wrong_a]].flatMap(([is, text]) => is ? `; ${text}` : []).join("");
  // A violation that is larger than the accuracy is told to be.
  const times = (off, { target }) => off > Number(target) ? `: ${stepbench.number(off / target)} times the accuracy` : "";
  // 'A (100 at h=0.1) and B (105 at h=0.2) tie; next: C, 2 times', as `verdict` of reports/verdicts.py says it.
  stepbench.verdict = (scene, question = stepbench.question) => {
    const own = stepbench.answer(question)[scene];
    if (!own) return [stepbench.unjudged(scene, question)];
    if (!own.first.length) {
      const near = nearest(scene, question), at = near && ` (${stepbench.number(near.error)} at ${stepbench.resolutionOf(runsOf(scene, near.index), near.k)}).`;
      return own.reached ? ["It is reached, at costs that are not measured."] : [`No method reaches ${question.target}`, ...(near ? ["; nearest: ", stepbench.methodRef(near.index), at] : ["."])];
    }
    const run = (m) => {
      const [, k, cost] = own.states[m], runs = runsOf(scene, m), off = stepbench.columnOf(runs, "constraint")?.[k];
      const held = off > 0 ? `; violation of Φ ${runs.phi[k]}${runs.phi[k] ? ", " : ""}relative ${stepbench.number(off)}${times(off, question)}` : "";
      return [stepbench.methodRef(m), ` (${stepbench.costWithUnit(cost, question.cost)} at ${stepbench.resolutionOf(runs, k)}${held}${marks(scene, own, m, question)})`];
    };
    const shown = own.first.slice(0, MOST).map(run), more = own.first.length - shown.length;
    const who = joined([...shown, ...(more ? [[`${more} more`]] : [])]);
    const next = own.second === null ? own.votes ? "" : "; none to compare" : "; next: ";
    return [...who, own.first.length === 1 ? own.votes && own.second === null ? " alone reaches it" : " is cheapest" : " tie", next,
      ...(own.second === null ? [] : [stepbench.methodRef(own.second), `, ${stepbench.multiple(own.states[own.second][0])} times`]), "."];
  };

  // A command that repeats the run of the verdict, or else the one that came nearest.
  const quoted = (word) => /[^\w@%+=:,./-]/.test(word) ? `'${word}'` : word;
  for (const place of document.querySelectorAll("[data-try]")) stepbench.onChange((question) => {
    const scene = Number(place.dataset.try), own = stepbench.answer()[scene];
    const best = winner(own), chosen = best || nearest(scene, question);
    const note = place.closest("section").querySelector(".note"), even = chosen && !/ x [\d./]+$/.test(data.methods[chosen.index].label);
    place.closest("section").hidden = !even;
    if (!even) return;
    const runs = runsOf(scene, chosen.index), { label } = data.methods[chosen.index];
    const [control, value] = stepbench.resolutionOf(runs, chosen.k, 6).split("="), end = Number(place.dataset.end);
    // Steps of even size are a whole number to the end.
    const even_step = end / Math.round(end / value), size = Math.abs(even_step / value - 1) < 2e-5 ? Number(even_step.toPrecision(6)) : value;
    place.textContent = `stepbench solve ${quoted(data.scenes[scene].id)} ${quoted(label)} ${control === "h" ? `--step ${size}` : `--rtol ${Number(Number(value).toPrecision(4))}`} --t-end ${place.dataset.end}${JSON.parse(place.dataset.plugins)[label] || ""}`;
    note.textContent = best ? `It repeats the run of ${data.methods[best.index].short} in the verdict.`
      : `${own ? own.reached === false || !own.states.some((state) => state === "unknown") ? "No method reaches" : "No cost is known at" : "The reference cannot judge"} ${question.target} in ${data.group_names[question.group]}; this run came nearest, with ${stepbench.number(chosen.error)}.`;
  });

  for (const place of document.querySelectorAll("[data-verdict]")) stepbench.onChange((question) => {
    const scene = Number(place.dataset.verdict), aim = stepbench.answer()[scene] ? [`To ${question.target} in ${data.group_names[question.group]}: `] : [];
    const verdict = [...aim, ...stepbench.verdict(scene, question)].map(stepbench.part);
    place.replaceChildren(html("p", {}, ...verdict), ...stepbench.wrong("scenes", place.dataset.verdict));
  });

  // The cost of a run over that of another one, with the interval of times, and whether they are told apart.
  const against = (runs, k, other, j, cost) => {
    const value = (of, run) => stepbench.columnOf(of, cost)[run], ratio = value(runs, k) / value(other, j);
    const [a, b] = cost === "seconds" ? [runs.spread[k], other.spread[j]] : [], ends = a && b ? [a[0] / b[1], a[1] / b[0]] : [ratio, ratio];
    const tie = Math.max(ratio, 1 / ratio) <= data.apart[cost === "seconds" && !(a && b) ? "few" : cost] || ends[0] <= 1 && ends[1] >= 1;
    return `${stepbench.number(ratio)} ×${a && b ? ` (interval ${ends.map((end) => stepbench.number(end)).join(" to ")})` : ""}${!tie ? "" : a && b ? ", intervals overlap" : ", not significant"}`;
  };
  // The run of the highlighted method that reaches the accuracy on a scene, or none.
  const highlighted = ({ highlight }, scene) => {
    const index = data.methods.findIndex(({ label }) => label === highlight), state = stepbench.answer()[scene]?.states[index];
    return Array.isArray(state) ? { index, k: state[1] } : null;
  };
  const heads = (question, mine) => [stepbench.costName(question), "multiple of the best", ...(mine ? [`multiple of ${data.methods[mine.index].short}`] : []), `error in ${data.group_names[question.group].split(" ").at(-1)}`];
  const filled = (table, caption, head, rows) => table.replaceChildren(html("caption", {}, caption),
    html("thead", {}, html("tr", {}, ...head.map((name) => html("th", { scope: "col" }, name)))), html("tbody", {}, ...rows));
  // A row that begins with the cells ``lead``: what the accuracy costs a method on a scene, or why it has no cost.
  const row = (lead, scene, index, state, question, mine, held) => {
    if (!Array.isArray(state)) {
      const runs = runsOf(scene, index), near = state === "far" && nearest(scene, question, index);
      const tried = near ? ` down to ${stepbench.resolutionOf(runs, runs.resolutions.length - 1)}; least error: ${stepbench.number(near.error)}` : "";
      const ends = state === "failed" ? `: ${[...new Set(runs.endings)].join(", ").replaceAll("_", " ")}` : state === "refused" ? `: ${runs.refused}` : "";
      const text = state ? STATES[state] + tried + ends : "cannot be judged";
      return html("tr", { class: "out" }, ...lead, html("td", { colspan: 3 + 2 * held + Boolean(mine) }, text));
    }
    const [multiple, k, cost] = state, runs = runsOf(scene, index), error = stepbench.columnOf(runs, question.group)[k];
    const off = held ? stepbench.columnOf(runs, "constraint")[k] : NaN;
    const violation = held ? [html("td", {}, runs.phi[k]), html("td", {}, stepbench.number(off), times(off, question))] : [];
    const beside = mine?.k === undefined || index === mine.index ? "" : against(runs, k, runsOf(scene, mine.index), mine.k, question.cost);
    return html("tr", data.methods[index].label === question.highlight ? { class: "mine" } : {}, ...lead, html("td", {}, stepbench.costText(cost, question.cost)),
      html("td", {}, `${stepbench.multiple(multiple)} ×`), ...(mine ? [html("td", {}, beside)] : []), html("td", {}, stepbench.number(error)), ...violation);
  };
  const refused = (runs) => runs.refused !== undefined && "refused";
  for (const table of document.querySelectorAll("[data-methods]")) stepbench.onChange((question) => {
    const scene = Number(table.dataset.methods), states = stepbench.answer()[scene]?.states || [];
    const multiple = ([, state]) => Array.isArray(state) ? state[0] : Infinity;
    const others = states.length ? data.runs_of[scene].filter(refused).map((runs) => [runs.method, "refused"]) : [];
    const found = [...Object.entries(states).filter(([, state]) => state !== null), ...others].sort((one, two) => multiple(one) - multiple(two) || 0);
    table.closest("section").hidden = !found.length;
    const held = data.scenes[scene].groups.includes("constraint"), mine = highlighted(question, scene), own = data.methods.find(({ label }) => label === question.highlight);
    const why = mine ? "" : own ? `; ${own.short} does not reach it` : "; highlight a method to compare all with it";
    filled(table, `Cheapest run of each with an error of at most ${question.target} in ${data.group_names[question.group]}, ${stepbench.norm()}${why}`,
      ["method", ...(held ? ["form"] : []), ...heads(question, mine), ...(held ? ["violation of Φ", "relative"] : [])],
      found.map(([index, state]) => row([stepbench.head(data.methods[index]), ...(held ? [html("td", {}, data.methods[index].form)] : [])], scene, Number(index), state, question, mine, held)));
  });
  // All scenes of one method, and how it stands there.
  for (const table of document.querySelectorAll("[data-scenes]")) stepbench.onChange((question) => {
    const index = data.methods.findIndex(({ label }) => label === table.dataset.scenes), answer = stepbench.answer();
    const other = data.methods.findIndex(({ label }) => label === question.highlight), mine = other >= 0 && other !== index ? { index: other } : null;
    const own = data.scenes.map((scene, k) => ({ scene, k, runs: runsOf(k, index), found: answer[k] })).filter(({ runs }) => runs);
    const count = (is) => own.filter(({ found }) => found && is(found)).length, wins = (found) => found.votes && found.first.includes(index);
    const best = (found) => found?.first.length ? joined(found.first.slice(0, MOST).map((m) => [part(stepbench.methodRef(m))])) : [];
    document.querySelector(`[data-standing="${table.id}"]`).textContent = `Reaches ${question.target} in ${data.group_names[question.group]} (${stepbench.norm()}) on ${count((found) => Array.isArray(found.states[index]) || found.states[index] === "unknown")} of ${count((found) => found.states[index])} scenes tried; at the least ${data.cost_words[question.cost]} alone on ${count((found) => wins(found) && found.alone)}, tied on ${count((found) => wins(found) && !found.alone)}.`;
    filled(table, `Its cheapest run with an error of at most ${question.target} in ${data.group_names[question.group]}, ${stepbench.norm()}, on each scene`,
      ["scene", ...heads(question, mine), "cheapest"], own.map(({ scene, k, runs, found }) => {
        const line = row([html("th", { scope: "row" }, stepbench.to(scene.page, { title: scene.id }, scene.name))], k, index, refused(runs) || found?.states[index], question, mine && { ...mine, ...highlighted(question, k) }, false);
        line.append(html("td", {}, ...best(found)));
        return line;
      }));
  });
})();
