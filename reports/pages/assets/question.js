// The question of the page: its bar, its address, who follows it, and its answers, made by reports/ranking.py.
"use strict";
(() => {
  const bar = document.getElementById("question"), followers = [], data = window.stepbenchData;
  const single = "single" in document.body.dataset, root = document.body.dataset.page === "front" ? "report/" : "";
  const first = { scenes: "all", highlight: "", ...data.first };
  // What can be chosen, with its words, in the order of the address.
  const choices = {
    group: data.group_names, target: Object.fromEntries(data.targets.map((target) => [target, target])),
    norm: data.norms, cost: data.cost_words,
    scenes: Object.fromEntries(data.filters.map((filter) => [filter.id, `${filter.name} (${filter.scenes.length})`])),
    highlight: { "": "no method", ...Object.fromEntries(data.methods.map((method) => [method.label, method.short])) },
  };

  // The next accuracy that is no larger, of those that can be asked for; nothing if there is none.
  const accuracy = (text) => Number(text) < 1 ? data.targets.find((target) => Number(text) >= Number(target)) : undefined;
  // The question that the address asks; what it does not say is the first question's.
  const asked = () => {
    const said = new URLSearchParams(stepbench.said());
    return Object.fromEntries(Object.entries(choices).map(([name, own]) => {
      const wanted = name === "target" ? accuracy(said.get(name)) : said.get(name);
      return [name, [wanted, first[name], ...Object.keys(own)].find((value) => Object.hasOwn(own, value))];
    }));
  };
  // Beside a typed accuracy: the one that is taken in its place, or why it is none.
  const tell = (typed, value = accuracy(typed)) => {
    bar.querySelector("output").textContent = typed === null || Number(value) === Number(typed) ? ""
      : value ? `The next accuracy of the table: ${value}.` : `“${typed}” is no accuracy: type a number from ${data.targets.at(-1)} to 1e-1, such as 2e-4.`;
  };
  // The norm is told where it is not the usual one.
  const address = (question = stepbench.question) => "#" + new URLSearchParams(Object.keys(choices)
    .filter((name) => name === "norm" ? question.norm !== data.first.norm : question[name] || data.first[name])
    .map((name) => [name, question[name]]));
  const follow = () => {
    stepbench.question = asked();
    stepbench.keep(address().slice(1));
    if (bar) {
      for (const name in choices) if (bar.elements[name]) bar.elements[name].value = stepbench.question[name];
      tell(new URLSearchParams(location.hash.slice(1)).get("target"));
      bar.querySelector("[type=reset]").hidden = address() === address(first);
    }
    for (const draw of followers) draw(stepbench.question);
  };

  Object.assign(stepbench, {
    data, question: asked(),
    // Call a function with the question, now and whenever it changes.
    onChange(draw) {
      followers.push(draw);
      draw(stepbench.question);
    },
    ask(change) {
      history.replaceState(null, "", address({ ...stepbench.question, ...change }));
      follow();
    },
    norm: ({ norm } = stepbench.question) => data.norms[norm],
    costName: (question = stepbench.question) => data.cost_names[question.cost],
    chosen: () => data.filters.find((filter) => filter.id === stepbench.question.scenes).scenes,
    // The numbers of a column for the runs of one method on one scene, NaN for none: a cost, or errors
    // in the norm that is asked for; nothing if no run has one.
    columnOf(runs, name) {
      const own = name in data.cost_names || stepbench.question.norm === data.first.norm;
      const k = data.columns.indexOf(own ? name : `${name}|${stepbench.question.norm}`);
      return k < 0 ? null : runs.resolutions.map((_, run) => runs.columns[k]?.[run] ?? NaN);
    },
    runsOf: (scene, index) => data.runs_of[scene].find((own) => own.method === index),
    // The error up to which the reference cannot judge.
    floor: (scene, { group, norm } = stepbench.question) =>
      data.scenes[scene].floor[norm === data.first.norm ? group : `${group}|${norm}`],
    // The address of a page; one file that holds all pages has anchors instead.
    page: (file) => single ? "#" + encodeURI(file.split("#")[1] || file.replace(/\.html$/, ""))
      : root + encodeURI(file) + (file.includes("#") ? "" : address()),
    // 'A, B, C and 2 more' of parts of sentences.
    listed: (all, most = 3) => [...all.slice(0, most), ...(all.length > most ? [[`${all.length - most} more`]] : [])]
      .flatMap((item, k, shown) => [...(k ? [k < shown.length - 1 ? ", " : " and "] : []), ...item]),
    methodRef: (index) => ({ kind: "method", key: data.methods[index].label, text: data.methods[index].short, page: data.methods[index].page }),
  });

  if (bar) {
    const options = (own) => Object.entries(own).map(([value, text]) => new Option(text, value));
    for (const name in choices) (name === "target" ? bar.elements.target.list : bar.elements[name])?.replaceChildren(...options(choices[name]));
    // The page of a scene offers the quantities that it has.
    const here = document.querySelector("article.scene [data-verdict]")?.dataset.verdict;
    if (here && !single) for (const option of bar.elements.group) option.disabled = !data.scenes[here].groups.includes(option.value);
    bar.addEventListener("change", ({ target: place }) => {
      const said = place.value, typed = place.name === "target", value = typed ? accuracy(said) : said;
      if (value !== undefined) stepbench.ask({ [place.name]: value });
      if (typed) tell(said);
    });
    bar.addEventListener("submit", (event) => event.preventDefault());
    bar.addEventListener("reset", (event) => {
      event.preventDefault();
      stepbench.ask(first);
    });
    const copy = bar.querySelector("[data-copy]");
    copy.addEventListener("click", async () => {
      history.replaceState(null, "", address());
      copy.textContent = await navigator.clipboard.writeText(location.href).then(() => "copied", () => "it is in the address line");
      setTimeout(() => { copy.textContent = "copy link"; }, 2000);
    });
    follow();
  }
  window.addEventListener("hashchange", () => {
    if (Object.keys(choices).some((name) => new URLSearchParams(location.hash.slice(1)).has(name))) follow();
  });

  // ---- answers ----
  const SIGNS = { "-": "far", "!": "failed", "?": "unknown" };
  // States of the methods: a name of SIGNS, or the multiple of the least cost, the run and its cost;
  // none of a method that was not tried.
  const onScene = (index, at, { target, cost }) => {
    const all = data.runs_of[index], parts = data.verdicts[at]?.map((k) => data.details[k]);
    const place = data.targets.indexOf(target), tie = parts?.[all.length + place];
    if (!tie) return null;
    const states = Array(data.methods.length).fill(null);
    all.forEach((runs, k) => {
      const sign = parts[k][place];
      if (!sign) return;
      const run = sign.charCodeAt() - 65;
      states[runs.method] = run < 0 ? SIGNS[sign] : [1, run, stepbench.columnOf(runs, cost)[run]];
    });
    const known = [...states.keys()].filter((m) => Array.isArray(states[m])).sort((one, two) => states[one][2] - states[two][2]);
    const samples = (m) => stepbench.runsOf(index, m).samples[states[m][1]];
    for (const m of known.slice(1)) states[m][0] = cost === "seconds" && Math.max(1, stepbench.quotient(samples(known[0]), samples(m))?.value) || states[m][2] / states[known[0]][2];
    // One that ties from a later start of the motion alone has -1 minus its place.
    const [counts, ...ties] = tie, later = ties.filter((m) => m < 0).map((m) => -1 - m), winners = ties.map((m) => m < 0 ? -1 - m : m);
    const order = all.map(({ method }) => method).filter((m) => states[m]);
    return {
      states, first: winners, later, order, votes: counts > 0, alone: counts === 1,
      second: known.find((m) => !winners.includes(m)) ?? null, reached: order.some((m) => stepbench.reaches(states[m])),
    };
  };
  stepbench.reaches = (state) => Array.isArray(state) || state === "unknown";

  // The answers on the scenes, null where none can be judged.
  const known = new Map();
  stepbench.answer = (question = stepbench.question) => {
    const key = [question.group, question.norm, question.cost].join("|"), whole = `${key}|${question.target}`;
    if (!known.has(whole)) known.set(whole, data.answers[key].map((at, index) => onScene(index, at, question)));
    return known.get(whole);
  };
  const judged = (question) => stepbench.chosen().map((k) => stepbench.answer(question)[k]).filter(Boolean);

  // Rows of methods: on how many scenes each is the cheapest alone, or tied, reaches it, was tried.
  stepbench.standings = (question) => {
    const rows = new Map();
    for (const scene of judged(question)) for (const method of scene.order) {
      const row = rows.get(method) || [method, 0, 0, 0, 0];
      if (scene.votes && scene.first.includes(method)) row[scene.alone ? 1 : 2] += 1;
      row[3] += stepbench.reaches(scene.states[method]);
      row[4] += 1;
      rows.set(method, row);
    }
    return [...rows.values()].sort((one, two) => two[1] + two[2] - one[1] - one[2] || two[1] - one[1] || two[3] - one[3] || one[4] - two[4]);
  };

  // 'A is cheapest on 6 of 9 scenes; 2 unreached.': `headline` of reports/verdicts.py.
  // With the leader by another cost, ``of``, its count is told where it does not lead: '; B on 1'.
  stepbench.headline = (question, of) => {
    const scenes = judged(question), rows = stepbench.standings(question), count = scenes.length;
    const every = ["", "the scene", "both scenes"][count] ?? `all ${count} scenes`, missed = scenes.filter((scene) => !scene.reached).length;
    const [, one, two] = rows[0] || [0, 0, 0], most = one + two;
    const lead = rows.filter(([, alone, tied]) => alone + tied === most).map(([m]) => [stepbench.methodRef(m)]);
    const kind = !most ? missed < count ? "unpriced" : count ? "nobody" : "unjudged" : lead.length > 1 ? "several" : "one";
    const alike = lead.length > 1 ? one ? " (ties)" : " (all tied)" : ` (${one} alone, ${two} tied)`;
    const but = rows.some(([, alone, tied]) => tied && alone + tied === most) ? alike : missed ? `; ${missed} unreached` : "";
    const any = count === 1 ? "the scene" : `any of the ${count} scenes judged`, on = most && most < count ? `${most} of ${count} scenes` : every;
    const [before, after] = data.headlines[kind].replace(/\{(on|but|target|any)\}/g, (_, name) => ({ on, but, target: question.target, any })[name]).split("{who}");
    const [leader] = of ? stepbench.standings(of) : [], own = leader && rows.find(([m]) => m === leader[0]);
    const beside = most && own && own[1] + own[2] < most ? [`; ${data.methods[own[0]].short} on ${own[1] + own[2] || "none"}.`] : [];
    const end = after === undefined ? [before] : [...stepbench.listed(lead), after];
    return beside.length ? [...end.slice(0, -1), end.at(-1).slice(0, -1), ...beside] : end;
  };
})();
