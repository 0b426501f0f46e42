// What all scripts share: makers of nodes, and the question, which goes along in links and the tab's memory.
"use strict";
window.stepbench = (() => {
  // Attributes are texts, or functions for events; those of false, null or undefined are left out.
  const filled = (node, attributes, children) => {
    for (const [name, value] of Object.entries(attributes)) {
      if (typeof value === "function") node.addEventListener(name, value);
      else if (value !== undefined && value !== null && value !== false) node.setAttribute(name, value);
    }
    node.append(...children);
    return node;
  };
  const html = (name, attributes = {}, ...children) => filled(document.createElement(name), attributes, children);
  const svg = (name, attributes = {}, ...children) => filled(document.createElementNS("http://www.w3.org/2000/svg", name), attributes, children);

  const button = (looks, ...content) => html("button", { type: "button", ...looks }, ...content);

  const key = `question of ${location.pathname.replace(/(report\/)?[^/]*$/, "")}`;
  const asks = (text) => /(^|&)(group|target|norm|cost|scenes|highlight)=/.test(text);
  // A browser without memory has the links.
  const memory = (use) => {
    try {
      return use(sessionStorage) || "";
    } catch {
      return "";
    }
  };
  // What the address asks, or else the tab remembers.
  const said = () => asks(location.hash.slice(1)) ? location.hash.slice(1) : memory((tab) => tab.getItem(key));
  const keep = (text) => {
    memory((tab) => tab.setItem(key, text));
    for (const link of document.links) {
      const [, page, anchor] = link.getAttribute("href").match(/^([^:?#]*\.html)(?:#(.*))?$/) || [];
      const own = link.dataset.highlight ? `highlight=${encodeURIComponent(link.dataset.highlight)}&` : "";
      if (page && (!anchor || asks(anchor))) link.href = `${page}#${own}${text}`;
    }
  };
  if (said()) keep(said());
  return { html, svg, button, said, keep };
})();
