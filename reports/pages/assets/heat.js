// The heat table: cost as a multiple of the cheapest, methods by rank and scenes by tag.
"use strict";
(() => {
  const { html, data } = stepbench;
  const table = document.getElementById("heat");
  if (!table) return;
  const STATES = {
    reached: ["", "the accuracy is reached"],
    unknown: ["?", "the accuracy is reached at a cost that was not measured"],
    far: ["–", "runs reached the end, none reached the accuracy"],
    failed: ["✕", "no run reached the end"],
    untried: ["", "not tried"],
    unjudged: ["·", "cannot be judged"],
  };
  // The cell with most colour is the cheapest; from this multiple on it has the least.
  const MOST = 100;

  // The scenes by kind, or all of a chosen set together.
  const grouped = (chosen) => {
    const filter = data.filters.find((f) => f.id === stepbench.question.scenes && f.id !== "all");
    if (filter) return [[filter.name, chosen]];
    const kinds = data.kinds.map((kind) => [kind, chosen.filter((k) => data.scenes[k].kind === kind)]).filter(([, own]) => own.length);
    return kinds.length > 1 ? kinds : [["all scenes", chosen]];
  };

  const cell = (method, index, answer) => {
    const scene = data.scenes[index], own = answer[index];
    const tried = data.runs_of[index].some((runs) => data.methods[runs.method] === method);
    const known = own?.states[data.methods.indexOf(method)] ?? (tried && !own ? "unjudged" : "untried");
    const reached = Array.isArray(known), state = reached ? "reached" : known, [ratio, k, cost] = reached ? known : [];
    const sign = STATES[state][0], meaning = state === "unjudged" ? stepbench.unjudged(index, stepbench.question) : STATES[state][1];
    const text = reached ? stepbench.times(ratio) : sign;
    const lines = [`${method.short} on ${scene.name}`, reached ? `${stepbench.multiple(ratio)} times the cheapest` : meaning];
    if (reached) {
      const runs = data.runs_of[index].find((of) => data.methods[of.method] === method);
      if (cost > 0) lines.push(`${stepbench.costWithUnit(cost, stepbench.question.cost)} at ${stepbench.resolutionOf(runs, k)}`);
    }
    const link = stepbench.to(scene.page, { "aria-label": lines.join(": ") }, text);
    const show = () => {
      const box = link.getBoundingClientRect();
      stepbench.tip.show(lines, box.right - 10, box.top);
    };
    for (const [event, what] of [["pointerenter", show], ["focus", show], ["pointerleave", stepbench.tip.hide], ["blur", stepbench.tip.hide]])
      link.addEventListener(event, what);
    const node = html("td", { class: state }, link);
    if (reached) {
      const near = 1 - Math.min(Math.log(ratio) / Math.log(MOST), 1);
      node.style.setProperty("--near", `${Math.round(8 + 92 * near)}%`);
      if (own.first.includes(data.methods.indexOf(method))) node.classList.add("first");
    }
    return node;
  };

  stepbench.onChange((question) => {
    const answer = stepbench.answer(), groups = grouped(stepbench.chosen());
    const ranked = stepbench.standings(question).map(([m]) => data.methods[m]);
    const rows = ranked.length ? ranked : data.methods;
    const tags = html("tr", {}, html("td"), ...groups.map(([name, own]) => html("th", { colspan: own.length, scope: "colgroup" }, name)));
    const names = html("tr", {}, html("th", { scope: "col" }, "method"), ...groups.flatMap(([, own]) => own.map((k, n) => {
      const { page, id, name } = data.scenes[k];
      return html("th", { scope: "col", class: n ? "" : "start" }, html("span", {}, stepbench.to(page, { title: id }, name)));
    })));
    const body = rows.map((method) => html("tr", { class: method.label === question.highlight ? "mine" : "" }, stepbench.head(method),
      ...groups.flatMap(([, own]) => own.map((k, n) => {
        const node = cell(method, k, answer);
        if (!n) node.classList.add("start");
        return node;
      }))));
    table.replaceChildren(
      html("caption", {}, `Cost in ${stepbench.costName(question)} to an error of ${question.target} in ${data.group_names[question.group]} (${stepbench.norm()}), as a multiple of the cheapest on the scene`),
      html("thead", {}, tags, names), html("tbody", {}, ...body));
  });

  const legend = document.getElementById("heat-legend");
  legend.append(...["reached", "far", "failed", "unknown", "unjudged", "untried"].map((state) => {
    const [sign, meaning] = STATES[state], reached = state === "reached";
    const sample = html("i", { class: state, "aria-hidden": "true" }, reached ? "1.0" : sign);
    sample.style.setProperty("--near", "100%");
    return html("span", {}, sample, reached ? "multiple of the cheapest: the more colour, the cheaper" : meaning);
  }));
})();
