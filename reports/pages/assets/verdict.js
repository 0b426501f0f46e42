// The verdict on one scene in words, and a table of its methods: what the asked accuracy costs each.
"use strict";
(() => {
  const { html, data } = stepbench;
  const STATES = {
    far: "not reached", failed: "no run reached the end", unknown: "reached, cost not measured",
  };

  for (const place of document.querySelectorAll("[data-verdict]")) stepbench.onChange((question) => {
    const said = stepbench.answer()?.verdicts?.[place.dataset.verdict];
    const verdict = (said || [stepbench.unjudged(Number(place.dataset.verdict), question)]).map(stepbench.part);
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
      html("caption", {}, `Cheapest run of each with an error of at most ${question.target} in ${data.group_names[question.group]}, ${data.norm}`),
      html("thead", {}, html("tr", {}, ...head.map((name) => html("th", { scope: "col" }, name)))),
      html("tbody", {}, ...found.map(([index, state]) => row(scene, Number(index), state, question))));
  });
})();
