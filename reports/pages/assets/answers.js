// The numbers of an answer, from the runs: to any accuracy, in any norm.
// The rules are those of reports/ranking.py and reports/questions; a test compares both.
"use strict";
(() => {
  const { data } = stepbench;
  const ZERO = 1e-35;
  const positive = (value) => value > 0;
  const cheapestOf = (found) => [...found].sort(([, one], [, two]) => one.cost - two.cost)[0]?.[1];

  // The cheapest run of a method that reaches the accuracy, the coarser of equal costs; null if none does.
  const cheapest = (errors, costs, target) => {
    const order = [...errors.keys()].filter((k) => errors[k] <= target * (1 + 1e-9)).sort((j, k) => errors[j] - errors[k]);
    if (!order.length) return null;
    let best = -1;
    for (const k of order) if (positive(costs[k]) && (best < 0 || costs[k] <= costs[best])) best = k;
    return best < 0 ? { run: -1 } : { run: best, cost: costs[best] };
  };

  const onScene = (index, question) => {
    const { group, cost } = question, target = Number(question.target), rules = data.rules[index];
    const trusted = rules?.trusted[question.norm][group];
    if (trusted === undefined || target < trusted) return null;
    const places = [];
    let count = 0;
    const tried = data.runs_of[index].map((runs) => {
      places.push(count);
      const number = stepbench.countOf(runs);
      count += number;
      return { ...runs, place: places.at(-1), number };
    }).filter((runs) => !runs.endings || runs.endings.some((ending) => !data.not_tried.includes(ending)));
    const alike = new Map(rules.alike), contestants = tried.filter((runs) => !alike.has(runs.method));
    const found = (start) => {
      const reached = new Map();
      for (const runs of contestants) {
        const errors = start ? stepbench.later(runs, group, start) : stepbench.columnOf(runs, group);
        const best = cheapest(errors, stepbench.columnOf(runs, cost), target);
        if (best) reached.set(runs.method, { ...best, place: runs.place + best.run });
      }
      return reached;
    };
    const apart = (one, two) => {
      if (cost === "seconds") {
        const [low, high] = [one.place, two.place].sort((j, k) => j - k);
        return low !== high && !rules.same_times[low].includes(high);
      }
      const [low, high] = [one.cost, two.cost].map((value) => value < ZERO ? 0 : value).sort((j, k) => j - k);
      return high > data.tie[cost] * low * (1 + 2e-5);
    };
    const reached = found(0), known = new Map([...reached].filter(([, own]) => own.run >= 0));
    const lucky = new Set();
    for (let start = 1; start <= (question.norm === data.first.norm ? data.starts : 0); start++) {
      const there = [...found(start)].filter(([, own]) => own.run >= 0), least = cheapestOf(there);
      for (const [method, own] of there) if (!apart(least, own)) lucky.add(method);
    }
    const best = cheapestOf(known), least = best?.cost;
    const ratio = ({ cost: value }) => value === least ? 1 : least < ZERO ? 1e40 : value / least;
    const tied = contestants.map((runs) => runs.method).filter(
      (method) => known.has(method) && (lucky.has(method) || !apart(best, known.get(method))));
    const states = Array(1 + Math.max(-1, ...tried.map((runs) => runs.method))).fill(null);
    for (const runs of tried) {
      const own = reached.get(alike.get(runs.method) ?? runs.method);
      const ended = !runs.endings || runs.endings.includes("ok");
      states[runs.method] = !own ? (ended ? "far" : "failed") : own.run < 0 ? "unknown" : [ratio(own), own.run];
    }
    const second = [...known].filter(([method]) => !tied.includes(method)).sort(([, one], [, two]) => one.cost - two.cost)[0];
    const unknown = [...reached].filter(([, own]) => own.run < 0).length;
    return {
      tied, states, reached: reached.size > 0, votes: contestants.length - unknown > 1,
      first: tied.flatMap((method) => tried.map((runs) => runs.method).filter((k) => (alike.get(k) ?? k) === method)),
      second: second ? [second[0], ratio(second[1])] : null,
      order: tried.map((runs) => runs.method),
    };
  };

  const standingsOf = (scenes) => {
    const rows = new Map();
    for (const scene of scenes) {
      for (const method of scene.order) {
        const row = rows.get(method) || [method, 0, 0, 0, 0], state = scene.states[method];
        row[3] += Array.isArray(state) || state === "unknown";
        row[4] += 1;
        rows.set(method, row);
      }
      if (scene.votes) for (const method of scene.first) rows.get(method)[scene.tied.length > 1 ? 2 : 1] += 1;
    }
    return [...rows.values()].sort((one, two) => two[1] + two[2] - one[1] - one[2] || two[1] - one[1] || two[3] - one[3] || one[4] - two[4]);
  };

  // 'A is cheapest on 6 of 9 scenes; nobody reaches 2.': `headline` of reports/questions/cheapest.py.
  const headlineOf = (scenes) => {
    const judged = scenes.length, missed = scenes.filter((scene) => !scene.reached).length;
    const every = judged === 1 ? "the scene" : judged === 2 ? "both scenes" : `all ${judged} scenes`;
    if (!judged) return ["No scene here can be judged."];
    if (missed === judged) return [`Nobody reaches it on ${every}.`];
    const where = new Map();
    for (const { votes, tied } of scenes) if (votes) for (const method of tied) {
      const row = where.get(method) || [method, 0, 0];
      row[1] += 1;
      row[2] += tied.length === 1;
      where.set(method, row);
    }
    if (!where.size) return ["It is reached, but no costs can be compared."];
    const order = [...where.values()].sort((one, two) => two[1] - one[1] || two[2] - one[2]), [, most, alone] = order[0];
    const lead = order.filter(([, count, wins]) => count === most && wins === alone).map(([method]) => stepbench.methodRef(method));
    const on = most === judged ? every : `${most} of ${judged} scenes`;
    const who = lead.length > 2 ? [`${lead.length} methods tie: each is cheapest on ${on}`]
      : lead.length === 2 ? [lead[0], " and ", lead[1], ` are each cheapest on ${on}`] : [lead[0], ` is cheapest on ${on}`];
    return [...who, alone < most ? (alone ? `, alone on ${alone}.` : ", always tied.") : missed ? `; nobody reaches ${missed}.` : "."];
  };

  // The answer to a question, as the data of the page have those that were written.
  stepbench.computed = (question) => {
    const scenes = data.scenes.map((_, index) => onScene(index, question));
    const filters = data.filters.map(({ id, scenes: chosen }) => {
      const own = chosen.map((k) => scenes[k]).filter(Boolean);
      return [id, { headline: headlineOf(own), standings: standingsOf(own) }];
    });
    return { scenes, filters: Object.fromEntries(filters) };
  };
})();
