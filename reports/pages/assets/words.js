// The answer in sentences, and the standings of all methods.
"use strict";
(() => {
  const { html, data, part } = stepbench;
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
      const method = data.methods[m];
      return html("tr", method.label === mine ? { class: "mine" } : {}, stepbench.head(method),
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
    const title = `Which integrator, for an error in ${data.group_names[question.group].replace(/ \S+$/, "")} of at most ${question.target}?`;
    document.querySelector("main h1").textContent = title;
    const unfolded = card.querySelector("details")?.open;
    const here = stepbench.answer(), line = (name, ...parts) => html("p", name ? { class: name } : {}, ...parts.map(part));
    const beside = data.both.filter((cost) => data.both.includes(question.cost) && cost !== question.cost);
    card.replaceChildren(line("headline", ...stepbench.headline(question)),
      ...beside.map((cost) => line("also", `${data.least[cost]}: `, ...stepbench.headline({ ...question, cost }, question))));
    const [wrong, ...which] = stepbench.wrong("filters", question.scenes);
    if (wrong) card.append(wrong);
    const more = html("details", unfolded ? { open: "" } : {}, html("summary", {}, "costs, rivals, constraints, and where it fails"));
    card.append(more);
    more.append(...which, line("", `To ${question.target} in ${data.group_names[question.group]} (${stepbench.norm()}), scene by scene:`), ...stepbench.chosen().map((k) => line("", { kind: "scene", key: data.scenes[k].id, text: data.scenes[k].name, page: data.scenes[k].page }, ": ", ...stepbench.verdict(k, question))));
    more.append(html("p", { class: "note" }, `Error: ${stepbench.violation(question) ? "of the worst constraint, relative to the change that positions and velocities of their size make" : "of the worst component, relative to its largest value in the reference"}, ${stepbench.norm()}. Tied: ${data.ties[question.cost]}, or the cheapest from a later start of the motion. Time is of this machine and of a method's language; operations are the same everywhere.`));
    standings(stepbench.standings(question), stepbench.chosen().filter((k) => here[k]).length);
  });
})();
