// Plays the drawings of a scene: <div class="motion"> with an SVG, controls, and frames as JSON.
"use strict";
for (const place of document.querySelectorAll(".motion")) {
  const [path, slider, button, label, data] = ["path", "input", "button", "output", "script"].map((name) => place.querySelector(name));
  const frames = JSON.parse(data.textContent), end = frames.length - 1, length = frames[end].t - frames[0].t;
  // Short motions are slowed down and long ones sped up: a play takes two to twelve seconds.
  const seconds = Math.min(Math.max(length, 2), 12), digits = Math.max(2, 2 - Math.floor(Math.log10(length || 1)));
  let playing = false, part = 0, last = null;
  const draw = () => {
    const { t, lines } = frames[slider.value];
    path.setAttribute("d", lines.filter((line) => line.length).map((line) => "M" + line.map((p) => p.join(" ")).join("L")).join(""));
    label.textContent = `t = ${t.toFixed(digits)} s`;
  };
  const tick = (now) => {
    if (!playing) return;
    part = (part + (now - (last ?? now)) / 1000 / seconds) % 1;
    last = now;
    slider.value = Math.round(part * end);
    draw();
    requestAnimationFrame(tick);
  };
  const press = (on) => {
    playing = on;
    last = null;
    button.textContent = on ? "Pause" : "Play";
    button.setAttribute("aria-pressed", on);
    if (on) requestAnimationFrame(tick);
  };
  button.onclick = () => press(!playing);
  slider.oninput = () => {
    press(false);
    part = slider.value / end;
    draw();
  };
  slider.max = end;
  place.querySelector(".controls").hidden = !end;
  press(end > 0 && !matchMedia("(prefers-reduced-motion: reduce)").matches);
  draw();
}
