// Plays the drawings of a scene: <div class="motion"> with an SVG, controls, and frames as JSON.
(() => {
  "use strict";
  const still = matchMedia("(prefers-reduced-motion: reduce)");
  const play = (place) => {
    const frames = JSON.parse(place.querySelector("script").textContent);
    const path = place.querySelector("path"), slider = place.querySelector("input");
    const button = place.querySelector("button"), label = place.querySelector("output");
    const length = frames[frames.length - 1].t - frames[0].t;
    // Short motions are slowed down and long ones sped up: a play takes two to twelve seconds.
    const seconds = Math.min(Math.max(length, 2), 12);
    const digits = Math.max(2, 2 - Math.floor(Math.log10(length || 1)));
    let playing = false, part = 0, last = null;
    slider.max = frames.length - 1;
    const draw = (k) => {
      path.setAttribute("d", frames[k].lines.filter((line) => line.length).map((line) => "M" + line.map((p) => p.join(" ")).join("L")).join(""));
      label.textContent = "t = " + frames[k].t.toFixed(digits) + " s";
    };
    const tick = (now) => {
      if (!playing) return;
      if (last !== null) {
        part = (part + (now - last) / 1000 / seconds) % 1;
        slider.value = Math.round(part * (frames.length - 1));
        draw(+slider.value);
      }
      last = now;
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
      part = slider.value / (frames.length - 1);
      draw(+slider.value);
    };
    place.querySelector(".controls").hidden = frames.length < 2;
    press(!still.matches && frames.length > 1);
    draw(0);
  };
  document.querySelectorAll(".motion").forEach(play);
})();
