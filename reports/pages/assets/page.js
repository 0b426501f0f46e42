// Tables that sort, filter and begin folded; tabs; contents that filter, and their menu on narrow
// screens. Without this script all rows and sections stand one below the other.
"use strict";
(() => {
  const FOLDED = 12, FILTERED = 8, FEW = 5;
  const reveals = [];  // each shows a place that it has; null: everything
  const make = (name, attributes, ...children) => {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    node.append(...children);
    return node;
  };

  // What a cell is sorted by: its number, or its text. Cells without a value come last.
  const valueOf = (cell) => {
    const text = (cell.dataset.value ?? cell.textContent).trim();
    const number = parseFloat(text.replace(/^[^\d.+-]*/, "")) * (/ million/.test(text) ? 1e6 : / billion/.test(text) ? 1e9 : 1);
    return /^[–-]?$/.test(text) ? null : /^[\s×<>≤~]*[+-]?[\d.]/.test(text) && !Number.isNaN(number) ? number : text;
  };
  const compare = (one, two) => {
    if (one === null || two === null) return (one === null) - (two === null);
    if (typeof one === "number" && typeof two === "number") return one - two;
    return String(one).localeCompare(String(two), undefined, { numeric: true });
  };

  for (const table of document.querySelectorAll("table.sortable")) {
    const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
    const rows = [...body.rows], first = [...rows];
    let open = rows.length <= FOLDED, wanted = "", order = first;
    const count = make("button", { type: "button", class: "unfold" });
    const show = () => {
      let n = 0, found = 0;
      for (const row of order) {
        const fits = row.textContent.toLowerCase().includes(wanted);
        found += fits;
        row.hidden = !fits || (!open && ++n > FOLDED);
      }
      count.hidden = open || found <= FOLDED;
      count.textContent = `show all ${found} rows`;
    };
    heads.forEach((head, column) => {
      if (!head.textContent.trim()) return;
      const button = make("button", { type: "button", class: "sort" }, ...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => {
        const before = head.getAttribute("aria-sort");
        for (const other of heads) other.removeAttribute("aria-sort");
        if (before === "descending") order = [...first];
        else {
          const down = before === "ascending";
          head.setAttribute("aria-sort", down ? "descending" : "ascending");
          const values = new Map(first.map((row) => [row, row.cells[column] ? valueOf(row.cells[column]) : null]));
          order = [...first].sort((one, two) => {
            const [a, b] = [values.get(one), values.get(two)];
            return a === null || b === null || !down ? compare(a, b) : -compare(a, b);
          });
        }
        body.append(...order);
        show();
      });
    });
    count.addEventListener("click", () => {
      open = true;
      show();
    });
    const frame = table.closest(".wide") || table;
    frame.after(count);
    if (rows.length > FILTERED) {
      const input = make("input", { type: "search", class: "filter", placeholder: "filter rows", "aria-label": "filter the rows of this table" });
      input.addEventListener("input", () => {
        wanted = input.value.trim().toLowerCase();
        show();
      });
      frame.before(input);
    }
    reveals.push((target) => {
      open ||= !target || table.contains(target);
      show();
    });
    show();
  }

  for (const box of document.querySelectorAll("[data-tabs]")) {
    const sections = [...box.querySelectorAll(":scope > .tab")];
    const buttons = sections.map((section) => {
      const button = make("button", { type: "button", id: `${section.id}-tab`, role: "tab", "aria-controls": section.id }, section.dataset.title);
      section.setAttribute("role", "tabpanel");
      section.setAttribute("aria-labelledby", button.id);
      return button;
    });
    const bar = make("div", { class: "tabbar", role: "tablist", "aria-label": "Details" }, ...buttons);
    const show = (k) => {
      sections.forEach((section, i) => { section.hidden = i !== k; });
      buttons.forEach((button, i) => {
        button.setAttribute("aria-selected", i === k);
        button.tabIndex = i === k ? 0 : -1;
      });
    };
    buttons.forEach((button, k) => button.addEventListener("click", () => show(k)));
    bar.addEventListener("keydown", (event) => {
      const now = buttons.indexOf(document.activeElement), last = buttons.length - 1;
      const next = { ArrowRight: now < last ? now + 1 : 0, ArrowLeft: now ? now - 1 : last, Home: 0, End: last }[event.key];
      if (next === undefined) return;
      event.preventDefault();
      show(next);
      buttons[next].focus();
    });
    box.prepend(bar);
    show(0);
    reveals.push((target) => {
      const k = sections.findIndex((section) => section.contains(target));
      if (k >= 0) show(k);
      else if (!target) for (const section of sections) section.hidden = false;
    });
    window.addEventListener("afterprint", () => show(buttons.findIndex((button) => !button.tabIndex)));
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
    const button = make("button", { type: "button", class: "menu", "aria-expanded": "false" }, "Contents");
    const set = (on) => {
      side.classList.toggle("open", on);
      button.setAttribute("aria-expanded", String(on));
    };
    button.addEventListener("click", () => set(!side.classList.contains("open")));
    side.addEventListener("keydown", (event) => { if (event.key === "Escape") set(false); });
    side.firstElementChild.after(button);
    side.classList.add("folds");
    const links = [...side.querySelectorAll("li")];
    if (links.length > FEW) {
      const input = make("input", { type: "search", class: "filter", placeholder: "find …", title: "a scene, a method or a word", "aria-label": "filter the contents" });
      const none = make("p", { class: "about", role: "status" });
      input.addEventListener("input", () => {
        const asked = input.value.trim().toLowerCase();
        for (const link of links) link.hidden = !link.textContent.toLowerCase().includes(asked);
        for (const part of side.querySelectorAll("div")) part.hidden = part.dataset.searched !== undefined && !asked || !part.querySelector("li:not([hidden])");
        none.textContent = links.every((link) => link.hidden) ? `Nothing is called “${input.value.trim()}”.` : "";
      });
      side.querySelector(".about").after(input, none);
    }
  }
})();
