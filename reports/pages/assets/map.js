// Tells the numbers of the run that is pointed at on a map of outcomes.
(() => {
  "use strict";
  const data = JSON.parse(document.getElementById("data").textContent);
  const image = document.querySelector("#map image");
  const point = document.getElementById("point"), told = document.getElementById("told");
  const [xName, xs] = data.x, [yName, ys] = data.y;
  const at = (part, count) => Math.min(count - 1, Math.max(0, Math.floor(part * count)));
  const tell = (event) => {
    const box = image.getBoundingClientRect();
    const i = at((event.clientX - box.left) / box.width, xs.length);
    const j = at((box.bottom - event.clientY) / box.height, ys.length);
    const error = data.error[j][i];
    told.textContent = `${xName} = ${+xs[i].toPrecision(5)}, ${yName} = ${+ys[j].toPrecision(5)}: ` +
      data.words[data.outcome[j][i]] + (error === null ? "" : `, error ${(10 ** error).toExponential(1)}`);
    const w = 700 / xs.length, h = 480 / ys.length;
    for (const [name, value] of [["x", 80 + i * w], ["y", 490 - (j + 1) * h], ["width", w], ["height", h]])
      point.setAttribute(name, value);
    point.style.visibility = "visible";
  };
  image.addEventListener("pointermove", tell);
  image.addEventListener("pointerdown", tell);
})();
