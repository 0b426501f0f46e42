// Tabs of a scene's page: <div data-tabs> with <section class="tab" data-title>. Without this script
// all sections stand one below the other. Links to places inside open their tab and their fold.
(() => {
  "use strict";
  const shows = [];
  const make = (box) => {
    const sections = [...box.querySelectorAll(":scope > .tab")];
    const bar = document.createElement("div");
    bar.className = "tabbar";
    bar.setAttribute("role", "tablist");
    bar.setAttribute("aria-label", "Details");
    const buttons = sections.map((section) => {
      const button = document.createElement("button");
      button.type = "button";
      button.id = section.id + "-tab";
      button.textContent = section.dataset.title;
      button.setAttribute("role", "tab");
      button.setAttribute("aria-controls", section.id);
      section.setAttribute("role", "tabpanel");
      section.setAttribute("aria-labelledby", button.id);
      bar.append(button);
      return button;
    });
    const show = (k) => {
      sections.forEach((section, i) => { section.hidden = i !== k; });
      buttons.forEach((button, i) => {
        button.setAttribute("aria-selected", i === k);
        button.tabIndex = i === k ? 0 : -1;
      });
    };
    buttons.forEach((button, k) => { button.onclick = () => show(k); });
    bar.onkeydown = (event) => {
      const now = buttons.indexOf(document.activeElement), last = buttons.length - 1;
      const next = { ArrowRight: now < last ? now + 1 : 0, ArrowLeft: now ? now - 1 : last, Home: 0, End: last }[event.key];
      if (next === undefined) return;
      event.preventDefault();
      show(next);
      buttons[next].focus();
    };
    box.prepend(bar);
    show(0);
    shows.push((target) => {
      const k = sections.findIndex((section) => section.contains(target));
      if (k >= 0) show(k);
    });
    // A paper has no tabs.
    const paper = (on) => { for (const section of sections) section.classList.toggle("printed", on); };
    addEventListener("beforeprint", () => paper(true));
    addEventListener("afterprint", () => paper(false));
  };
  const open = () => {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    shows.forEach((show) => show(target));
    for (let fold = target.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
    target.scrollIntoView();
  };
  document.querySelectorAll("[data-tabs]").forEach(make);
  addEventListener("hashchange", open);
  open();
})();
