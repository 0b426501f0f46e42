// The panels of the front page: one chart per chosen scene, with the scene's picture.
"use strict";
(() => {
  const { svg, html, data } = stepbench;
  const panels = document.getElementById("panels");
  if (!panels) return;
  const picture = (lines) => svg("svg", { class: "picture", viewBox: "-6 -6 112 112", width: 44, height: 44, "aria-hidden": "true" },
    ...lines.map((line) => svg("path", { d: "M" + line.map((p) => p.join(" ")).join("L") })));
  const cards = data.scenes.map((scene, index) => {
    const place = html("div", { class: "chart" }), link = html("a", { "data-question": "" }, scene.name);
    const card = html("article", { class: "panel" }, html("header", {}, picture(scene.picture),
      html("div", {}, html("h3", { title: scene.id }, link), html("p", {}, scene.about || "\u00a0"))), place);
    link.href = stepbench.page(scene.page);
    return { card, place, index };
  });
  let broad = 0;
  const choose = () => {
    const chosen = new Set(stepbench.chosen());
    for (const { card, index } of cards) card.hidden = !chosen.has(index);
    // All panels are equally wide: measured once, before the first is drawn.
    broad = cards.find(({ card }) => !card.hidden)?.place.clientWidth;
  };
  const draw = ({ card, place, index }) => {
    if (!card.hidden) stepbench.draw(place, index, { wide: broad });
  };
  panels.append(...cards.map(({ card }) => card));
  stepbench.onChange(choose);
  for (const own of cards) stepbench.onChange(() => draw(own), own.card);
  let wide = innerWidth;
  window.addEventListener("resize", () => {
    if (Math.abs(innerWidth - wide) < 20) return;
    wide = innerWidth;
    choose();
    cards.forEach(draw);
  });
})();
