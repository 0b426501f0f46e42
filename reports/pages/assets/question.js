// The question of the page: its bar, its place in the address, and whoever follows it.
"use strict";
(() => {
  const NAMES = ["group", "target", "norm", "cost", "scenes", "highlight"];
  const bar = document.getElementById("question");
  const followers = [];
  const data = window.stepbenchData;
  const single = "single" in document.body.dataset, root = document.body.dataset.page === "front" ? "report/" : "";

  // The numbers of a column for the runs of one method on one scene, NaN for none: a cost, or errors
  // in the norm that is asked for; nothing if no run has one.
  const columnOf = (runs, name) => {
    const own = name in data.cost_names || stepbench.question.norm === data.first.norm;
    const k = data.columns.indexOf(own ? name : `${name}|${stepbench.question.norm}`);
    return k < 0 ? null : runs.resolutions.map((_, run) => runs.columns[k]?.[run] ?? NaN);
  };
  const endingOf = (runs, k) => runs.endings?.[k] ?? "ok";
  // The step or tolerance of a run in words.
  const resolutionOf = (runs, k, digits = 4) => {
    const value = Number(runs.resolutions[k].toPrecision(digits));
    return `${runs.control}=${value < 1e-3 ? value.toExponential() : value}`;
  };

  // The next accuracy that is no larger, of those that can be asked for; nothing if there is none.
  const accuracy = (text) => Number(text) < 1 ? data.targets.find((target) => Number(text) >= Number(target)) ?? "" : "";

  const choices = () => ({
    group: Object.keys(data.group_names),
    norm: Object.keys(data.norms),
    cost: Object.keys(data.cost_names),
    scenes: data.filters.map((filter) => filter.id),
    highlight: ["", ...data.methods.map((method) => method.label)],
  });

  // The question that the address asks; what it does not say is the first question's.
  const asked = () => {
    const said = new URLSearchParams(keptQuestion.said());
    const known = choices(), first = { scenes: "all", ...data.first };
    const question = {};
    for (const name of NAMES) {
      const value = said.get(name);
      if (name === "target") {
        question.target = accuracy(value) || first.target;
        continue;
      }
      question[name] = known[name].includes(value) ? value
        : known[name].includes(first[name]) ? first[name] : known[name][0];
    }
    return question;
  };

  // The norm is told where it is not the usual one.
  const told = (question) => NAMES.filter((name) => name === "norm" ? question.norm !== data.first.norm : question[name] || data.first[name]);
  const address = (question = stepbench.question) =>
    "#" + new URLSearchParams(told(question).map((name) => [name, question[name]]));

  const stepbench = {
    data, columnOf, endingOf, resolutionOf, address,
    question: asked(),
    // Call a function with the question, now and whenever it changes.
    onChange(draw) {
      followers.push(draw);
      draw(stepbench.question);
    },
    ask(change) {
      history.replaceState(null, "", address({ ...stepbench.question, ...change }));
      follow();
    },
    methodRef(index) {
      const { label, short, page } = data.methods[index];
      return { kind: "method", key: label, text: short, page };
    },
    norm: ({ norm } = stepbench.question) => data.norms[norm],
    // The error up to which the reference cannot judge.
    floor: (scene, { group, norm } = stepbench.question) => data.scenes[scene].floor[norm === data.first.norm ? group : `${group}|${norm}`],
    // Sentences on runs that reach the end and are wrong, as paragraphs.
    wrong: (of, which) => (stepbench.data.wrong[stepbench.question.group]?.[of][which] || []).map(
      (parts) => stepbench.html("p", { class: "wrong" }, ...parts.map(stepbench.part))),
    chosen: () => data.filters.find((filter) => filter.id === stepbench.question.scenes).scenes,
    // The address of a page; one file that holds all pages has anchors instead.
    page: (file) => single ? "#" + encodeURI(file.split("#")[1] || file.replace(/\.html$/, "")) : root + encodeURI(file) + (file.includes("#") ? "" : address()),
    // Whether the question is about constraints; methods hold them up to the rounding of Φ.
    violation: ({ group }) => group.startsWith("constraint"),
    costName: (question = stepbench.question) => data.cost_names[question.cost],
  };
  window.stepbench = stepbench;

  const initial = { ...stepbench.question, scenes: "all", highlight: "", ...data.first };
  const follow = () => {
    stepbench.question = asked();
    for (const name of NAMES) if (bar?.elements[name]) bar.elements[name].value = stepbench.question[name];
    keptQuestion.keep(address().slice(1));
    if (bar) bar.querySelector("[type=reset]").hidden = address() === address(initial);
    for (const draw of followers) draw(stepbench.question);
  };

  const fill = (select, values, texts) => {
    select.replaceChildren(...values.map((value, k) => new Option(texts[k], value)));
  };
  if (bar) {
    const known = choices();
    fill(bar.elements.group, known.group, Object.values(data.group_names));
    fill(document.getElementById("accuracies"), data.targets, data.targets);
    fill(bar.elements.norm, known.norm, Object.values(data.norms));
    fill(bar.elements.cost, known.cost, Object.values(data.cost_words));
    if (bar.elements.scenes) fill(bar.elements.scenes, known.scenes, data.filters.map((f) => `${f.name} (${f.scenes.length})`));
    fill(bar.elements.highlight, known.highlight, ["no method", ...data.methods.map((m) => m.short)]);
    bar.addEventListener("change", ({ target: place }) => {
      const typed = place.name === "target", value = typed ? accuracy(place.value) : place.value;
      const refused = typed && !value;
      if (typed) bar.querySelector("output").textContent = refused ? `“${place.value}” is no accuracy: type a number from ${data.targets.at(-1)} to 1, such as 2e-4.`
        : Number(value) < Number(place.value) * (1 - 1e-9) ? `The next accuracy of the table: ${value}.` : "";
      if (!refused) stepbench.ask({ [place.name]: value });
    });
    bar.addEventListener("submit", (event) => event.preventDefault());
    bar.addEventListener("reset", (event) => {
      event.preventDefault();
      stepbench.ask(initial);
    });
    const copy = bar.querySelector("[data-copy]");
    copy?.addEventListener("click", async () => {
      history.replaceState(null, "", address());
      try {
        await navigator.clipboard.writeText(location.href);
        copy.textContent = "copied";
      } catch {
        copy.textContent = "it is in the address line";
      }
      setTimeout(() => { copy.textContent = "copy link"; }, 2000);
    });
    follow();
  }
  window.addEventListener("hashchange", () => {
    const said = new URLSearchParams(location.hash.slice(1));
    if (NAMES.some((name) => said.has(name))) follow();
  });
})();
