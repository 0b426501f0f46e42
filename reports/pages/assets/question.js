// The question of the page: its bar, its place in the address, and whoever follows it.
"use strict";
(() => {
  const ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
  const VALUES = new Map([...ALPHABET].map((letter, k) => [letter, k]));
  const NAMES = ["group", "target", "cost", "scenes", "highlight"];
  const bar = document.getElementById("question");
  const followers = [];
  const decoded = new Map();
  const source = document.getElementById("stepbench-data");
  const data = JSON.parse(source.textContent);
  data.root = source.dataset.root || "";
  data.complete = !source.dataset.more;
  const single = source.dataset.single !== undefined;

  // A run of a method on a scene is a list.
  const named = (scenes) => scenes.map((own) => own.map(
    ([method, at, columns, endings, status]) => ({ method, at, columns, endings, status })));
  data.runs_of = named(data.runs_of);

  // Numbers of a column, so many characters each; NaN for none.
  const numbers = (text, letters) => {
    const found = new Float64Array(text.length / letters), none = "-".repeat(letters);
    for (let k = 0; k < found.length; k++) {
      const part = text.slice(letters * k, letters * (k + 1));
      let bits = 0;
      for (const letter of part) bits = 64 * bits + VALUES.get(letter);
      // A fourth character that was left out is taken as its middle.
      if (letters === 3) bits = 64 * bits + 31.5;
      found[k] = part === none ? NaN : 10 ** (80 * bits / (2 ** 24 - 1) - 40);
    }
    return found;
  };

  const decode = (text, letters = 4) => {
    const key = letters + text;
    if (!decoded.has(key)) decoded.set(key, numbers(text, letters));
    return decoded.get(key);
  };
  // The numbers of a column for the runs of one method on one scene, if the page has them.
  const columnOf = (runs, name) => {
    const k = data.columns.indexOf(name);
    return k < 0 ? null : decode(runs.columns[k], data.letters);
  };
  const endingOf = (runs, k) => runs.endings ? runs.endings[runs.status[k]] : "ok";
  // The step or tolerance of a run in words.
  const resolutionOf = (runs, k) => {
    const [, control, text] = data.resolutions[runs.at].match(/^(h|rtol)(.*)$/);
    const value = Number(decode(text)[k].toPrecision(4));
    return `${control}=${value < 1e-3 ? value.toExponential() : value}`;
  };

  const choices = () => ({
    group: Object.keys(data.group_names),
    target: data.targets,
    cost: Object.keys(data.cost_names),
    scenes: data.filters.map((filter) => filter.id),
    highlight: ["", ...data.methods.map((method) => method.label)],
  });

  // The question that the address asks; what it does not say is the first question's.
  const asked = () => {
    const said = new URLSearchParams(location.hash.slice(1)), known = choices();
    const first = { scenes: "all", ...data.first };
    const question = {};
    for (const name of NAMES) {
      const value = said.get(name);
      question[name] = known[name].includes(value) ? value
        : known[name].includes(first[name]) ? first[name] : known[name][0];
    }
    return question;
  };

  const address = (question = stepbench.question) =>
    "#" + new URLSearchParams(NAMES.filter((name) => question[name] || data.first[name]).map((name) => [name, question[name]]));

  const stepbench = {
    data, columnOf, endingOf, resolutionOf, address,
    question: asked(),
    // Call a function with the question, now and whenever it or the data change: soon if it
    // draws in a place that is out of sight.
    onChange(draw, place) {
      followers.push({ draw, place });
      draw(stepbench.question);
    },
    // Take in the data of all other questions.
    more(rest) {
      for (const name of ["letters", "columns", "resolutions", "answers", "wrong", "refs", "profiles"]) data[name] = rest[name];
      data.runs_of = named(rest.runs_of);
      data.complete = true;
      follow();
    },
    ask(change) {
      history.replaceState(null, "", address({ ...stepbench.question, ...change }));
      follow();
    },
    answer: () => data.answers[["group", "target", "cost"].map((name) => stepbench.question[name]).join("|")],
    // Sentences on runs that reach the end and are wrong, as paragraphs.
    wrong: (of, which) => (stepbench.data.wrong[stepbench.question.group]?.[of][which] || []).map(
      (parts) => stepbench.html("p", { class: "wrong" }, ...parts.map(stepbench.part))),
    chosen: () => data.filters.find((filter) => filter.id === stepbench.question.scenes).scenes,
    // The address of a page; one file that holds all pages has anchors instead.
    page: (file) => single ? "#" + encodeURI(file.split("#")[1] || file.replace(/\.html$/, "")) : data.root + encodeURI(file) + (file.includes("#") ? "" : address()),
    // Whether the question is about constraints; methods hold them up to the rounding of Φ.
    violation: ({ group }) => group.startsWith("constraint"),
    costName: (question = stepbench.question) => data.cost_names[question.cost],
  };
  window.stepbench = stepbench;

  // Milliseconds that a reader may wait, and those that later pieces of work may take.
  const PATIENCE = 80, PIECE = 30;
  let waiting = [], later = 0;
  const work = (milliseconds) => {
    const end = performance.now() + milliseconds;
    while (waiting.length && performance.now() < end) waiting.shift().draw(stepbench.question);
    clearTimeout(later);
    if (waiting.length) later = setTimeout(work, 0, PIECE);
  };
  // How far a place is out of sight.
  const far = (place) => {
    const box = place?.getBoundingClientRect();
    return box ? Math.max(0, box.top - innerHeight, -box.bottom) : 0;
  };
  window.addEventListener("beforeprint", () => work(Infinity));

  const follow = () => {
    stepbench.question = asked();
    for (const name of NAMES) if (bar?.elements[name]) bar.elements[name].value = stepbench.question[name];
    for (const link of document.querySelectorAll("a[data-question]")) {
      link.hash = address();
    }
    waiting = followers.map((follower) => [far(follower.place), follower])
      .sort(([one], [two]) => one - two).map(([, follower]) => follower);
    work(PATIENCE);
  };

  const fill = (select, values, texts) => {
    select.replaceChildren(...values.map((value, k) => new Option(texts[k], value)));
  };
  if (bar) {
    const known = choices();
    fill(bar.elements.group, known.group, Object.values(data.group_names));
    fill(bar.elements.target, known.target, known.target);
    fill(bar.elements.cost, known.cost, Object.values(data.cost_words));
    if (bar.elements.scenes) fill(bar.elements.scenes, known.scenes, data.filters.map((f) => `${f.name} (${f.scenes.length})`));
    fill(bar.elements.highlight, known.highlight, ["no method", ...data.methods.map((m) => m.short)]);
    bar.addEventListener("change", (event) => stepbench.ask({ [event.target.name]: event.target.value }));
    bar.addEventListener("submit", (event) => event.preventDefault());
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

  // The data of the other questions come after the first drawing.
  window.addEventListener("load", () => {
    const place = source.dataset.more;
    if (!place) return;
    const script = document.createElement("script");
    script.src = place;
    requestAnimationFrame(() => setTimeout(() => document.body.append(script)));
  });
})();
