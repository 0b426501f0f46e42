// The answers to a question: looked up in the tables that reports/ranking.py has filled.
"use strict";
(() => {
  const { data } = stepbench;
  const SIGNS = { "-": "far", "!": "failed", "?": "unknown" };

  // States of the methods: a name of SIGNS, or the multiple of the least cost, the run and its cost;
  // none of a method that was not tried.
  const onScene = (index, at, { target, cost }) => {
    const all = data.runs_of[index], parts = data.verdicts[at]?.map((k) => data.details[k]);
    const place = data.targets.indexOf(target), tie = parts?.[all.length + place];
    if (!tie) return null;
    const states = Array(data.methods.length).fill(null);
    all.forEach(({ method }, k) => {
      const sign = parts[k][place];
      if (!sign) return;
      const run = sign.charCodeAt() - 65;
      states[method] = run < 0 ? SIGNS[sign] : [1, run, stepbench.columnOf(all[k], cost)[run]];
    });
    // One that ties from a later start of the motion alone has -1 minus its place.
    const [counts, ...ties] = tie, first = ties.map((m) => m < 0 ? -1 - m : m), later = ties.filter((m) => m < 0).map((m) => -1 - m), known = [...states.keys()].filter((m) => Array.isArray(states[m])).sort((one, two) => states[one][2] - states[two][2]);
    for (const m of known) states[m][0] = m === known[0] ? 1 : states[m][2] / states[known[0]][2];
    const order = all.map(({ method }) => method).filter((m) => states[m]);
    return {
      states, first, later, order, votes: counts > 0, alone: counts === 1, second: known.find((m) => !first.includes(m)) ?? null,
      several: order.length > 1,
      reached: order.some((m) => Array.isArray(states[m]) || states[m] === "unknown"),
    };
  };

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
    for (const scene of judged(question)) {
      for (const method of scene.order) {
        const row = rows.get(method) || [method, 0, 0, 0, 0], state = scene.states[method];
        row[3] += Array.isArray(state) || state === "unknown";
        row[4] += 1;
        rows.set(method, row);
      }
      if (scene.votes) for (const method of scene.first) rows.get(method)[scene.alone ? 1 : 2] += 1;
    }
    return [...rows.values()].sort((one, two) => two[1] + two[2] - one[1] - one[2] || two[1] - one[1] || two[3] - one[3] || one[4] - two[4]);
  };

  // 'A is cheapest on 6 of 9 scenes; nobody reaches 2.': `headline` of reports/verdicts.py.
  // With the leader by another cost, ``of``, its count is told where it does not lead: ' (B on 1)'.
  stepbench.headline = (question, of) => {
    const scenes = judged(question), rows = stepbench.standings(question), count = scenes.length;
    const every = ["", "the scene", "both scenes"][count] ?? `all ${count} scenes`, missed = scenes.filter((scene) => !scene.reached).length;
    const [, one, two] = rows[0] || [0, 0, 0], most = one + two;
    const lead = rows.filter(([, alone, tied]) => alone === one && alone + tied === most).map(([m]) => stepbench.methodRef(m));
    const kind = !most ? missed < count ? "unpriced" : count ? "nobody" : "unjudged" : ["", "one", "two"][lead.length] ?? "many";
    const but = one < most ? `, with ${two} ${two === 1 ? "tie" : "ties"}` : missed ? `; nobody reaches ${missed}` : "";
    const values = { on: most && most < count ? `${most} of ${count} scenes` : every, but, count: lead.length, target: question.target, any: count === 1 ? "the scene" : `any of the ${count} scenes judged` };
    const [before, after] = data.headlines[kind].replace(/\{(on|but|count|target|any)\}/g, (_, name) => values[name]).split("{who}");
    const [first] = of ? stepbench.standings(of) : [], own = first && rows.find(([m]) => m === first[0]);
    const beside = most && own && own[1] + own[2] < most ? [` (${data.methods[own[0]].short} on ${own[1] + own[2] || "none"}).`] : [];
    const end = after === undefined ? [before] : [...lead.flatMap((ref, k) => k ? [" and ", ref] : [ref]), after];
    return beside.length ? [...end.slice(0, -1), end.at(-1).slice(0, -1), ...beside] : end;
  };
})();
