// The verdict on a scene in words, and tables of costs: of each method on a scene, of a method on each scene.
"use strict";
(() => {
  const { html, button, data, part, runsOf, columnOf, number, quotient, columns, fill } = stepbench;
  const STATES = { far: "not reached", failed: "no run reached the end", unknown: "reached, cost not measured", refused: "the method does not take the scene" };
  // The run of the least error of some methods on a scene: its method, place and error.
  const nearest = (all, { group }) => {
    let best = null;
    for (const runs of all) columnOf(runs, group)?.forEach((error, k) => {
      if (error > 0 && !(best?.error <= error)) best = { index: runs.method, k, error };
    });
    return best;
  };
  // The run of a method that reaches the accuracy on a scene, or none.
  const reaching = (scene, index) => {
    const state = stepbench.answer()[scene]?.states[index];
    return Array.isArray(state) ? { index, k: state[1] } : null;
  };
  // The step or tolerance of a run, told to be the finest of its method that reached the end.
  const last = (runs) => runs.endings?.lastIndexOf("ok") ?? runs.resolutions.length - 1, size = (runs, k) => runs.resolutions[k] + (k !== last(runs) ? "" : ", its finest run" + (k < runs.resolutions.length - 1 ? " to the end" : ""));
  const times = (off, { target }) => off > Number(target) ? `: ${number(off / target)} times the accuracy` : "";
  const quantity = ({ group }) => data.group_names[group];
  // 'A (100 at h=0.1) and B (105 at h=0.2) tie; next: C, 2 times', as `verdict` of reports/verdicts.py says it.
  stepbench.verdict = (scene, question = stepbench.question) => {
    const own = stepbench.answer(question)[scene];
    if (!own) return [stepbench.unjudged(scene, question)];
    const near = nearest(data.runs_of[scene].filter((runs) => own.states[runs.method] && !stepbench.reaches(own.states[runs.method])), question);
    const closest = near ? ["; nearest: ", stepbench.methodRef(near.index), ` (${number(near.error)} at ${size(runsOf(scene, near.index), near.k)}).`] : ["."];
    if (!own.first.length)
      return own.reached ? ["It is reached, at costs that are not measured."] : [`No method reaches ${question.target} in ${quantity(question)}`, ...closest];
    const run = (m) => {
      const [, k, cost] = own.states[m], runs = runsOf(scene, m), off = columnOf(runs, "constraint")?.[k];
      const said = [`${stepbench.costWithUnit(cost, question.cost)} at ${runs.resolutions[k]}`];
      if (off > 0) said.push(`violation of Φ ${runs.phi[k]}${runs.phi[k] ? ", " : ""}relative ${number(off)}${times(off, question)}`);
      // It ties from a later start alone, or its accelerations are wrong.
      if (own.later.includes(m)) said.push(data.later);
      if (question.group !== "a" && data.scenes[scene].wrong_a.includes(m)) said.push(data.wrong_a);
      return [stepbench.methodRef(m), ` (${said.join("; ")})`];
    };
    const next = own.second, rest = next !== null ? ["; next: ", stepbench.methodRef(next), `, ${stepbench.multiple(own.states[next][0])} times.`]
      : own.votes && own.first.length < 2 ? closest : [own.votes ? "." : "; none to compare."];
    return [...stepbench.listed(own.first.map(run)),
      own.first.length > 1 ? " tie" : own.votes && next === null ? " alone reaches it" : " is cheapest", ...rest];
  };
  // Whom to avoid on a scene: those that cost ten times the least or more, and those that do not reach the accuracy.
  const avoided = ({ second, states }) => {
    const of = (is) => [...states.entries()].filter(([, state]) => state !== null && is(state)), { listed, methodRef, multiple } = stepbench;
    const dear = of(([ratio]) => ratio >= 10).sort(([, [one]], [, [two]]) => two - one).map(([m, [ratio]]) => [methodRef(m), ` (${multiple(ratio)} ×)`]);
    const far = of((state) => state === "far" || state === "failed").map(([m]) => [methodRef(m)]);
    return second !== null ? [...(dear.length ? ["Costly: ", ...listed(dear), ". "] : []), ...(far.length ? ["Not reached by ", ...listed(far), "."] : [])] : [];
  };
  // What a method costs over another one on a scene, at the finest accuracy of at least that of the question that both reach; of times the median quotient in rounds with its interval, and whether it is significant.
  const compared = (scene, question, ...two) => {
    const states = (target) => two.map((m) => stepbench.answer({ ...question, target })[scene]?.states[m]), { cost } = question;
    const target = two[0] !== two[1] && data.targets.findLast((one) => Number(one) >= Number(question.target) && states(one).every(Array.isArray));
    if (!target) return "";
    const asked = target === question.target, { first = [], later } = stepbench.answer()[scene] ?? {}, [[runs, k], [other, j]] = states(target).map(([, k], n) => [runsOf(scene, two[n]), k]);
    const tied = asked && two.every((m) => first.includes(m)) && `a tie${two.some((m) => later.includes(m)) ? " from a later start" : ""}`;
    const found = cost === "seconds" ? quotient(other.samples[j], runs.samples[k]) : null, value = found?.value ?? columnOf(runs, cost)[k] / columnOf(other, cost)[j];
    const sizes = `${asked ? "" : `at ${target}: ${stepbench.costWithUnit(columnOf(runs, cost)[k], cost)}, `}${stepbench.multiple(value)} ×`, differs = Math.max(value, 1 / value) > (found?.few ? data.few : data.apart[cost]);
    if (cost !== "seconds") return sizes + (tied ? `, ${tied}` : differs ? "" : ", not significant");
    const ends = found ? [...new Set([found.low, found.high].map(number))] : [], word = found && differs && (found.low > 1 || found.high < 1) ? "significant" : "not significant";
    return `${sizes}${ends.length > 1 ? ` (${ends.join(" to ")})` : ""}, ${tied || word}${found?.few === false ? "" : " (few samples)"}`;
  };
  const placeOf = (label) => data.methods.findIndex((method) => method.label === label), best = (scene) => reaching(scene, stepbench.answer()[scene]?.first[0]);
  // The highlighted method beside the best on a scene, or the accuracy that it reaches there.
  const beside = (scene, question) => {
    const m = placeOf(question.highlight), own = stepbench.answer()[scene], runs = m >= 0 && own && runsOf(scene, m);
    if (!runs || own.first.slice(0, 3).includes(m)) return [];
    const mine = reaching(scene, m), first = best(scene), near = nearest([runs], question), next = near && data.targets.findLast((target) => Number(target) >= near.error);
    if (mine) return [[stepbench.methodRef(m), `: ${stepbench.costWithUnit(own.states[m][2], question.cost)} at ${runs.resolutions[mine.k]}, `,
      `${compared(scene, question, m, first.index)}, beside `, stepbench.methodRef(first.index), "; ",
      button({ class: "more", click: () => document.querySelector("[data-methods]").closest("[data-tabs]").scrollIntoView() }, "compare with all"), "."].map(part)];
    return [[part(stepbench.methodRef(m)), " does not reach it", ...(near ? [`: its least error is ${number(near.error)}`] : []), ...(next ? ["; ", button({ class: "more", click: () => stepbench.ask({ target: next }) }, `ask for ${next}`)] : []), "."]];
  };
  for (const place of document.querySelectorAll("[data-verdict]")) stepbench.onChange((question) => {
    const scene = Number(place.dataset.verdict), own = stepbench.answer()[scene], relative = stepbench.violation(question);
    const aim = own?.reached ? [`To ${question.target}${relative ? " (relative)" : ""} in ${quantity(question)}: `] : [];
    const others = own?.reached ? avoided(own).map(part) : [], verdict = [[...aim, ...stepbench.verdict(scene, question)].map(part), ...beside(scene, question)];
    place.replaceChildren(...[...verdict, others].filter((parts) => parts.length).map((parts) => html("p", {}, ...parts)), ...stepbench.wrong("scenes", scene));
  });

  // A command that repeats the run of the verdict, or else the one that came nearest.
  for (const place of document.querySelectorAll("[data-try]")) stepbench.onChange((question) => {
    const scene = Number(place.dataset.try), own = stepbench.answer()[scene], best = own && reaching(scene, own.first[0]);
    const run = best || nearest(data.runs_of[scene], question), method = data.methods[run?.index], card = place.closest("section");
    card.hidden = !method?.command;
    if (card.hidden) return;
    place.textContent = ["stepbench solve", data.scenes[scene].command, method.command, runsOf(scene, run.index).options[run.k],
      "--t-end", `${place.dataset.end}${method.plugins}`].join(" ");
    const why = !own ? "The reference cannot judge" : own.reached && own.states.includes("unknown") ? "No cost is known at" : "No method reaches";
    card.querySelector(".note").textContent = best ? `It repeats the run of ${method.short} in the verdict.`
      : `${why} ${question.target} in ${quantity(question)}; this run came nearest, with ${number(run.error)}.`;
  });

  const heads = (question, mine) => [stepbench.costName(question), `multiple of ${mine ? data.methods[mine.index].short : "the best"}${question.cost === "seconds" ? ", in rounds" : ""}`,
    `error in ${quantity(question).split(" ").at(-1)}`];
  const aim = (question) => `with an error of at most ${question.target} in ${quantity(question)}, ${stepbench.norm()}`;
  // A row that begins with the cells ``lead``: what the accuracy costs a method on a scene, or why it has no cost.
  const row = (lead, scene, index, state, question, mine, held) => {
    const runs = runsOf(scene, index), than = mine ?? best(scene), beyond = than && compared(scene, question, index, than.index) || "";
    if (!Array.isArray(state)) {
      const near = state === "far" && nearest([runs], question), lost = near ? (runs.endings ?? []).filter((end) => end !== "ok").length : 0,
        far = near ? `: least error ${number(near.error)}, down to ${runs.resolutions[last(runs)]}${lost ? `, ${lost} failed` : ""}` : "";
      const told = { far, failed: `: ${[...new Set(runs.endings)].join(", ").replaceAll("_", " ")}`, refused: `: ${runs.refused}` };
      const text = state ? STATES[state] + (told[state] ?? "") : stepbench.unjudged(scene, question);
      return html("tr", { class: "out" }, ...lead, html("td", { colspan: mine && beyond ? 1 : 3 + 2 * held }, text), ...(mine && beyond ? [html("td", {}, beyond), html("td", { colspan: 1 + 2 * held })] : []));
    }
    const [, k, cost] = state, off = held ? columnOf(runs, "constraint")[k] : NaN;
    const cells = [stepbench.costText(cost, question.cost), than.index === index ? "1 ×" : beyond, number(columnOf(runs, question.group)[k]), ...(held ? [runs.phi[k], number(off) + times(off, question)] : [])];
    return html("tr", { class: data.methods[index].label === question.highlight && "mine" }, ...lead, ...cells.map((text) => html("td", {}, text)));
  };
  const refused = (runs) => runs.refused !== undefined && "refused";
  for (const table of document.querySelectorAll("[data-methods]")) stepbench.onChange((question) => {
    const scene = Number(table.dataset.methods), states = stepbench.answer()[scene]?.states;
    const dear = ([, state]) => Array.isArray(state) ? state[2] : Infinity;
    const others = states ? data.runs_of[scene].filter(refused).map((runs) => [runs.method, "refused"]) : [];
    const found = [...(states || []).entries(), ...others].filter(([, state]) => state !== null).sort((one, two) => dear(one) - dear(two) || 0);
    table.closest("section").hidden = !found.length;
    const held = data.scenes[scene].groups.includes("constraint"), own = placeOf(question.highlight), mine = runsOf(scene, own) ? { index: own } : null;
    const why = own < 0 ? "; highlight a method to compare all with it" : reaching(scene, own) ? "" : `; ${data.methods[own].short} does not reach it, and is compared where both do`;
    const names = ["method", ...heads(question, mine), ...(held ? ["violation of Φ", "relative"] : [])];
    fill(table, `Cheapest run of each ${aim(question)}${why}`, [columns(...names)], found.map(([index, state]) => {
      const head = stepbench.head(data.methods[index]);
      if (held && !data.methods[index].short.endsWith(data.methods[index].form)) head.append(" ", html("small", {}, data.methods[index].form));
      return row([head], scene, index, state, question, mine, held);
    }));
  });
  // All scenes of one method, and how it stands there.
  for (const table of document.querySelectorAll("[data-scenes]")) stepbench.onChange((question) => {
    const index = placeOf(table.dataset.scenes), other = placeOf(question.highlight), mine = other >= 0 && other !== index ? { index: other } : null;
    const own = stepbench.answer().map((found, k) => ({ scene: data.scenes[k], k, runs: runsOf(k, index), found })).filter(({ runs }) => runs);
    const count = (is) => own.filter(({ found }) => found && is(found)).length, wins = (found) => found.votes && found.first.includes(index);
    const reached = count((found) => stepbench.reaches(found.states[index])), tried = count((found) => found.states[index]);
    document.querySelector(`[data-standing="${table.id}"]`).textContent =
      `Reaches ${question.target} in ${quantity(question)} (${stepbench.norm()}) on ${reached} of ${tried} scenes tried; ` +
      `at the least ${data.cost_words[question.cost]} alone on ${count((found) => wins(found) && found.alone)}, tied on ${count((found) => wins(found) && !found.alone)}.`;
    document.querySelector(`[data-wrong="${table.id}"]`).replaceChildren(...stepbench.wrong("methods", index));
    const names = ["scene", ...heads(question, mine), "cheapest"];
    fill(table, `Its cheapest run ${aim(question)}, on each scene`, [columns(...names)], own.map(({ scene, k, runs, found }) => {
      const lead = html("th", { scope: "row" }, stepbench.to(scene.page, { title: scene.id }, scene.name));
      const line = row([lead], k, index, refused(runs) || found?.states[index], question, mine, false);
      line.append(html("td", {}, ...stepbench.listed((found?.first || []).map((m) => [part(stepbench.methodRef(m))]))));
      return line;
    }));
  });
})();
