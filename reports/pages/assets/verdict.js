// The verdict on one scene in words, and a table of its methods: what the asked accuracy costs each.
"use strict";
(() => {
  const { html, data } = stepbench;
  const STATES = {
    far: "not reached", failed: "no run reached the end", unknown: "reached, cost not measured",
  };

  const runsOf = (scene, index) => data.runs_of[scene].find((own) => own.method === index);
  // The run of the least error of all on a scene: its method, place and error.
  const nearest = (scene, question) => {
    let best = null;
    for (const runs of data.runs_of[scene]) stepbench.columnOf(runs, question.group).forEach((error, k) => {
      if (error > 0 && !(best?.error <= error)) best = { index: runs.method, k, error };
    });
    return best;
  };
  // The run of the verdict: the cheapest, or none.
  const winner = (scene, own) => {
    const index = own?.first[0], state = own?.states[index];
    return Array.isArray(state) ? { index, k: state[1] } : null;
  };
  // The verdict on a question for which no sentence was written.
  const found = (scene, own, question) => {
    if (!own) return null;
    const goal = `${question.target} in ${data.group_names[question.group]} (${stepbench.norm()})`;
    const best = winner(scene, own), near = nearest(scene, question);
    if (!best) return own.reached ? [`To ${goal}, no costs can be compared.`] : [`No integrator reaches ${goal}`, ...(near ? ["; nearest: ", stepbench.methodRef(near.index), ` with ${stepbench.number(near.error)}`] : []), "."];
    const runs = runsOf(scene, best.index), cost = stepbench.columnOf(runs, question.cost)[best.k];
    const does = own.first.length > 1 ? ` and ${own.first.length - 1} more tie` : " is cheapest";
    const next = own.second ? [`; next: `, stepbench.methodRef(own.second[0]), `, ${stepbench.times(own.second[1])} times`] : [];
    return [`To ${goal}, `, stepbench.methodRef(best.index), `${does} (${stepbench.costWithUnit(cost, question.cost)} at ${stepbench.resolutionOf(runs, best.k)}`, ...next, ")."];
  };

  // A command that repeats the run of the verdict, or else the one that came nearest.
  const quoted = (word) => /[^\w@%+=:,./-]/.test(word) ? `'${word}'` : word;
  for (const place of document.querySelectorAll("[data-try]")) stepbench.onChange((question) => {
    const scene = Number(place.dataset.try), own = stepbench.answer()?.scenes[scene];
    const best = winner(scene, own), chosen = best || nearest(scene, question);
    const note = place.closest("section").querySelector(".note"), even = chosen && !/ x [\d./]+$/.test(data.methods[chosen.index].label);
    note.textContent = "";
    if (!even) return;
    const runs = runsOf(scene, chosen.index), { label } = data.methods[chosen.index];
    const [control, value] = stepbench.resolutionOf(runs, chosen.k, 6).split("="), end = Number(place.dataset.end);
    // Steps of even size are a whole number to the end.
    const even_step = end / Math.round(end / value), size = Math.abs(even_step / value - 1) < 2e-5 ? Number(even_step.toPrecision(6)) : value;
    place.textContent = `stepbench solve ${quoted(data.scenes[scene].id)} ${quoted(label)} ${control === "h" ? `--step ${size}` : `--rtol ${Number(Number(value).toPrecision(4))}`} --t-end ${place.dataset.end}${JSON.parse(place.dataset.plugins)[label] || ""}`;
    note.textContent = best ? "It repeats the run of the verdict."
      : `${own ? own.reached === false || !own.states.some((state) => state === "unknown") ? "No integrator reaches" : "No cost is known at" : "The reference cannot judge"} ${question.target} in ${data.group_names[question.group]}; this run came nearest, with ${stepbench.number(chosen.error)}.`;
  });

  for (const place of document.querySelectorAll("[data-verdict]")) stepbench.onChange((question) => {
    const scene = Number(place.dataset.verdict), answer = stepbench.answer();
    const said = stepbench.said()?.verdicts?.[scene] || found(scene, answer?.scenes[scene], question);
    const verdict = (said || [stepbench.unjudged(scene, question)]).map(stepbench.part);
    place.replaceChildren(html("p", {}, ...verdict), ...stepbench.wrong("scenes", place.dataset.verdict));
  });

  const row = (scene, index, state, question) => {
    const method = data.methods[index], link = html("a", { title: method.label }, method.short);
    link.href = stepbench.page(method.page);
    const head = html("th", { scope: "row" }, stepbench.badge(method), link);
    const held = data.scenes[scene].groups.includes("constraint");
    const form = held ? [html("td", {}, method.form)] : [];
    if (!Array.isArray(state))
      return html("tr", { class: "out" }, head, ...form, html("td", { colspan: 3 + held }, STATES[state]));
    const [multiple, k] = state, runs = data.runs_of[scene].find((own) => own.method === index);
    const [cost, error] = [question.cost, question.group].map((name) => stepbench.columnOf(runs, name)[k]);
    // A violation that is larger than the accuracy is told to be.
    const off = held ? stepbench.columnOf(runs, "constraint")[k] : NaN;
    const violation = held ? [html("td", {}, stepbench.number(off), off > Number(question.target) ? ` > ${question.target}` : "")] : [];
    return html("tr", method.label === question.highlight ? { class: "mine" } : {}, head, ...form,
      html("td", {}, stepbench.costText(cost, question.cost)), html("td", {}, `${stepbench.multiple(multiple)} ×`),
      html("td", {}, stepbench.number(error)), ...violation);
  };
  for (const table of document.querySelectorAll("[data-methods]")) stepbench.onChange((question) => {
    const scene = Number(table.dataset.methods), states = stepbench.answer()?.scenes[scene]?.states || [];
    const multiple = ([, state]) => Array.isArray(state) ? state[0] : Infinity;
    const found = Object.entries(states).filter(([, state]) => state !== null).sort((one, two) => multiple(one) - multiple(two) || 0);
    table.closest("section").hidden = !found.length;
    const held = data.scenes[scene].groups.includes("constraint");
    const head = ["method", ...(held ? ["form"] : []), stepbench.costName(question), "multiple of the best", `error in ${data.group_names[question.group].split(" ").at(-1)}`, ...(held ? ["violation of Φ, relative"] : [])];
    table.replaceChildren(
      html("caption", {}, `Cheapest run of each with an error of at most ${question.target} in ${data.group_names[question.group]}, ${stepbench.norm()}`),
      html("thead", {}, html("tr", {}, ...head.map((name) => html("th", { scope: "col" }, name)))),
      html("tbody", {}, ...found.map(([index, state]) => row(scene, Number(index), state, question))));
  });
})();
