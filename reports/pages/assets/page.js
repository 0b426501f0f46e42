// Tables that sort, filter and fold; tabs; contents that filter. Without it all stands one below the other.
"use strict";
(() => {
  const { html, button } = stepbench, FOLDED = 12, FILTERED = 8, FEW = 5;
  const reveals = [];  // each shows a place that it has; null: everything
  // A field that tells what is typed in it, and how that is to be compared.
  const search = (looks, tell) => html("input", {
    type: "search", class: "filter", ...looks, input: ({ target: { value } }) => tell(value.trim(), value.trim().toLowerCase()),
  });
  const has = (node, wanted) => node.textContent.toLowerCase().includes(wanted);

  // What a cell is sorted by: its number, or its text. Cells without a value come last.
  const valueOf = (cell) => {
    const text = cell.textContent.trim(), scale = / million/.test(text) ? 1e6 : / billion/.test(text) ? 1e9 : 1;
    const number = /^[\s×<>≤~]*[+-]?[\d.]/.test(text) ? parseFloat(text.replace(/^[^\d.+-]*/, "")) * scale : NaN;
    return /^[–-]?$/.test(text) ? null : Number.isNaN(number) ? text : number;
  };
  const compare = (one, two, way) => {
    if (one === null || two === null) return (one === null) - (two === null);
    return way * (typeof one === "number" && typeof two === "number" ? one - two : String(one).localeCompare(two, undefined, { numeric: true }));
  };
  for (const table of document.querySelectorAll("table.sortable")) {
    const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells], rows = [...body.rows], frame = table.closest(".wide");
    let open = rows.length <= FOLDED, typed = "";
    const show = () => {
      const found = [...body.rows].filter((row) => has(row, typed)), shown = new Set(open ? found : found.slice(0, FOLDED));
      for (const row of rows) row.hidden = !shown.has(row);
      count.hidden = shown.size === found.length;
      count.textContent = `show all ${found.length} rows`;
    };
    const unfold = (target) => {
      open ||= !target || table.contains(target);
      show();
    };
    const count = button({ class: "unfold", click: () => unfold(null) });
    heads.forEach((head, column) => head.textContent.trim() && head.append(button({ class: "sort", click() {
      const next = { null: "ascending", ascending: "descending" }[head.getAttribute("aria-sort")], way = next === "descending" ? -1 : 1;
      for (const other of heads) other.removeAttribute("aria-sort");
      if (next) head.setAttribute("aria-sort", next);
      const values = new Map(rows.map((row) => [row, valueOf(row.cells[column])]));
      body.append(...(next ? rows.toSorted((one, two) => compare(values.get(one), values.get(two), way)) : rows));
      show();
    } }, ...head.childNodes)));
    frame.after(count);
    if (rows.length > FILTERED) frame.before(search({ placeholder: "filter rows", "aria-label": "filter the rows of this table" }, (_, wanted) => {
      typed = wanted;
      show();
    }));
    reveals.push(unfold);
    show();
  }

  for (const box of document.querySelectorAll("[data-tabs]")) {
    const sections = [...box.querySelectorAll(":scope > .tab")];
    let now = 0;
    const show = (k) => {
      now = k;
      sections.forEach((section, i) => {
        section.hidden = i !== k;
        buttons[i].setAttribute("aria-selected", i === k);
        buttons[i].tabIndex = i === k ? 0 : -1;
      });
    };
    const buttons = sections.map((section, k) => button(
      { id: `${section.id}-tab`, role: "tab", "aria-controls": section.id, click: () => show(k) }, section.dataset.title));
    for (const section of sections) {
      section.setAttribute("role", "tabpanel");
      section.setAttribute("aria-labelledby", `${section.id}-tab`);
    }
    box.prepend(html("div", { class: "tabbar", role: "tablist", "aria-label": "Details", keydown(event) {
      const last = buttons.length - 1, next = { ArrowRight: now < last ? now + 1 : 0, ArrowLeft: now ? now - 1 : last, Home: 0, End: last }[event.key];
      if (next === undefined) return;
      event.preventDefault();
      show(next);
      buttons[next].focus();
    } }, ...buttons));
    show(0);
    reveals.push((target) => {
      const k = sections.findIndex((section) => section.contains(target));
      if (k >= 0) show(k);
      else if (!target) for (const section of sections) section.hidden = false;
    });
    window.addEventListener("afterprint", () => show(now));
  }

  // A link to a place opens its tab, table and fold; paper has no folds.
  const reveal = () => {
    const target = location.hash.length > 1 && document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (!target) return;
    for (const own of reveals) own(target);
    for (let fold = target.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
    target.scrollIntoView({ block: target.tagName === "TR" ? "center" : "start" });
  };
  window.addEventListener("hashchange", reveal);
  reveal();
  window.addEventListener("beforeprint", () => {
    for (const own of reveals) own(null);
    for (const fold of document.querySelectorAll("main details:not(.chart *)")) fold.open = true;
  });

  const side = document.querySelector("nav.side");
  if (side) {
    const set = (on) => menu.setAttribute("aria-expanded", side.classList.toggle("open", on));
    const menu = button({ class: "menu", "aria-expanded": "false", click: () => set(!side.classList.contains("open")) }, "Contents");
    side.addEventListener("keydown", (event) => { if (event.key === "Escape") set(false); });
    side.firstElementChild.after(menu);
    side.classList.add("folds");
    const latin = (text) => text.replaceAll("α", "alpha"), plain = (link) => ` ${latin(link.textContent.toLowerCase()).replace(/[^\p{L}\d.]+/gu, " ")}`;
    const links = [...side.querySelectorAll("li")], none = html("p", { class: "about", role: "status" });
    const looks = { placeholder: "find …", title: "a scene, a method or a word", "aria-label": "filter the contents" };
    if (links.length > FEW) side.querySelector(".about").after(search(looks, (typed, wanted) => {
      // What is found has the most words that begin with those that are typed, in its title above all.
      const words = latin(wanted).split(/[^\p{L}\d.]+/u).filter(Boolean);
      const count = (node) => words.filter((word) => plain(node).includes(` ${word}`)).length, score = (link) => count(link) + count(link.firstElementChild.firstChild) / 10, most = Math.max(1, ...links.map(score));
      for (const link of links) link.hidden = words.length > 0 && score(link) < most;
      for (const part of side.querySelectorAll("div"))
        part.hidden = "searched" in part.dataset && !wanted || !part.querySelector("li:not([hidden])");
      none.textContent = links.every((link) => link.hidden) ? `Nothing is called “${typed}”.` : "";
    }), none);
  }
})();
