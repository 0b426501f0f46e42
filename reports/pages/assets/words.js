// The answer in sentences, and the standings of all methods.
"use strict";
(() => {
  const { html, data } = stepbench;
  // A part of a sentence is text, or the place of a reference to something in the report.
  const part = (place) => {
    if (typeof place === "string") return place;
    const item = typeof place === "object" ? place : data.refs[place];
    const method = item.kind === "method" && data.methods.find((m) => m.label === item.key);
    const text = item.text || item.key;
    const node = item.page ? html("a", { class: item.kind, title: item.title || item.key }, text)
      : html("span", { class: item.kind, title: item.title || item.key }, text);
    if (item.page) node.href = stepbench.page(item.page);
    if (method) node.style.color = `color-mix(in oklab, ${stepbench.colour(method)} 70%, var(--ink))`;
    return node;
  };
  stepbench.part = part;

  const card = document.getElementById("answer"), table = document.getElementById("standings");
  if (!card) return;

  const bar = (alone, tied, reached, of, method) => {
    const track = html("span", { class: "track", "aria-hidden": "true" });
    track.style.setProperty("--own", stepbench.colour(method));
    for (const [name, n] of [["reached", reached], ["tied", alone + tied], ["alone", alone]]) {
      const piece = html("i", { class: name });
      piece.style.width = `${100 * n / Math.max(of, 1)}%`;
      track.append(piece);
    }
    return track;
  };

  const MOST = 5;
  let folded = true;
  const standings = (rows, of) => {
    const mine = stepbench.question.highlight;
    const shown = folded ? rows.filter(([m], k) => k < MOST || data.methods[m].label === mine) : rows;
    const head = html("tr", {}, html("th", { scope: "col" }, "method"), html("td"), ...["alone", "tied", "reached"].map(
      (name) => html("th", { scope: "col" }, name)));
    const body = html("tbody", {}, ...shown.map(([m, alone, tied, reached, tried]) => {
      const method = data.methods[m], link = html("a", { title: method.label }, method.short);
      link.href = stepbench.page(method.page);
      return html("tr", method.label === mine ? { class: "mine" } : {},
        html("th", { scope: "row" }, stepbench.badge(method), link),
        html("td", {}, bar(alone, tied, reached, of, method)),
        html("td", {}, alone), html("td", {}, tied),
        html("td", { title: `reached on ${reached} of ${tried} scenes tried` }, `${reached}`, html("small", {}, ` of ${tried}`)));
    }));
    table.replaceChildren(html("caption", {}, `Cheapest alone or tied, and reached, of ${of} ${of === 1 ? "scene" : "scenes"}${of < stepbench.chosen().length ? " that can be judged" : ""}`), html("thead", {}, head), body);
    const rest = rows.length - shown.length;
    if (rest > 0 || !folded) {
      const button = html("button", { type: "button", class: "more" }, folded ? `${rest} more` : "fewer");
      button.addEventListener("click", () => {
        folded = !folded;
        standings(rows, of);
      });
      body.append(html("tr", {}, html("td", { colspan: 5 }, button)));
    }
  };

  stepbench.onChange((question) => {
    const own = stepbench.answer()?.filters[question.scenes];
    const title = `Which integrator, for an error in ${data.group_names[question.group].replace(/ \S+$/, "")} of at most ${question.target}?`;
    document.querySelector("main h1").textContent = title;
    const unfolded = card.querySelector("details")?.open;
    card.replaceChildren(html("p", { class: "headline" }, ...(own ? own.headline.map(part) : [data.complete
      ? "No run here can be judged by this question." : "The other answers are being read."])));
    const [wrong, ...which] = stepbench.wrong("filters", question.scenes);
    if (wrong) card.append(wrong);
    const more = html("details", unfolded ? { open: "" } : {}, html("summary", {}, "costs, rivals, constraints, and where it fails"));
    card.append(more);
    const said = stepbench.said()?.filters[question.scenes];
    if (!said && data.complete) more.append(html("p", {}, `Sentences are written for accuracies from ${data.targets[0]} to ${data.targets.at(-1)}, ${stepbench.norm(data.first)}; the tables and charts below answer this question.`));
    more.append(...which, ...(said?.sentences || []).map((parts) => html("p", {}, ...parts.map(part))));
    more.append(html("p", { class: "note" }, `Error: ${stepbench.violation(question) ? "of the worst constraint, relative to the change that positions and velocities of their size make" : "of the worst component, relative to its largest value in the reference"}, ${stepbench.norm()}. Tied: ${data.ties[question.cost]}.`));
    const judged = stepbench.chosen().filter((k) => stepbench.answer()?.scenes[k]).length;
    standings(own ? own.standings : [], judged);
  });
})();
