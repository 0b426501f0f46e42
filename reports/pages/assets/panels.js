// The panels of the front page: one chart per chosen scene, with the scene's picture; one of them
// may be large. The legend of all methods below them hides and shows methods in all charts.
"use strict";
(() => {
  const { svg, html, data } = stepbench;
  const panels = document.getElementById("panels");
  if (!panels) return;
  const picture = (lines) => svg("svg", { class: "picture", viewBox: "-6 -6 112 112", width: 44, height: 44, "aria-hidden": "true" },
    ...lines.map((line) => svg("path", { d: "M" + line.map((p) => p.join(" ")).join("L") })));
  const cards = data.scenes.map((scene, index) => {
    const place = html("div", { class: "chart" }), link = stepbench.to(scene.page, {}, scene.name);
    const button = html("button", { type: "button", class: "enlarge", "aria-expanded": "false", "aria-label": `large chart: ${scene.name}`, title: "large chart; Escape closes it" }, "⤢");
    const card = html("article", { class: "panel" }, html("header", {}, picture(scene.picture),
      html("div", {}, html("h3", { title: scene.id }, link), html("p", { title: scene.about }, scene.about || "\u00a0")), button), place);
    return { card, place, index, button };
  });
  let broad = 0, large = null;
  const choose = () => {
    const chosen = new Set(stepbench.chosen());
    for (const { card, index } of cards) card.hidden = !chosen.has(index);
    // All panels but a large one are equally wide: measured once, before the first is drawn.
    broad = cards.find((own) => !own.card.hidden && own !== large)?.place.clientWidth;
  };
  const draw = (own) => {
    if (!own.card.hidden) stepbench.draw(own.place, own.index, own === large ? { large: true } : { wide: broad });
  };
  const enlarge = (wanted) => {
    const changed = [large, wanted].filter(Boolean);
    large = wanted;
    for (const own of changed) {
      own.card.classList.toggle("enlarged", own === large);
      own.button.setAttribute("aria-expanded", own === large);
      draw(own);
    }
    changed.at(-1).button.focus();
    changed.at(-1).card.scrollIntoView({ block: "nearest" });
  };
  for (const own of cards) own.button.addEventListener("click", () => enlarge(own === large ? null : own));
  window.addEventListener("keydown", (event) => { if (event.key === "Escape" && large) enlarge(null); });
  panels.append(...cards.map(({ card }) => card));

  const families = new Map();
  data.methods.forEach(({ family }, m) => families.set(family, [...families.get(family) || [], m]));
  const entry = (places, ...content) => html("button", { type: "button", class: "switch", "aria-pressed": "true", "data-method": places.join(" ") }, ...content);
  const legend = html("div", { class: "chooser", role: "group", "aria-label": "Methods in the charts" }, entry([...data.methods.keys()], "all methods"));
  for (const [family, own] of [...families].sort(([, one], [, two]) => two.length - one.length)) {
    const names = own.map((m) => entry([m], stepbench.badge(data.methods[m]), data.methods[m].short));
    names.forEach((name) => { name.title = family; });
    legend.append(html("span", {}, ...(own.length > 1 ? [entry(own, `${family}:`)] : []), ...names));
  }
  panels.after(legend);

  stepbench.onChange(choose);
  for (const own of cards) stepbench.onChange(() => draw(own));
  let wide = innerWidth;
  window.addEventListener("resize", () => {
    if (Math.abs(innerWidth - wide) < 20) return;
    wide = innerWidth;
    choose();
    cards.forEach(draw);
  });
})();
