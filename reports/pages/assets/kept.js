// The question goes with the reader: in the links to other pages, and in a memory of the tab.
"use strict";
window.keptQuestion = (() => {
  const key = `question of ${location.pathname.replace(/(report\/)?[^/]*$/, "")}`;
  const asks = (text) => /(^|&)(group|target|norm|cost|scenes|highlight)=/.test(text);
  const remembered = () => {
    try {
      return sessionStorage.getItem(key) || "";
    } catch {
      return "";
    }
  };
  // What the address asks, or else the tab remembers.
  const said = () => asks(location.hash.slice(1)) ? location.hash.slice(1) : remembered();
  const keep = (text) => {
    try {
      sessionStorage.setItem(key, text);
    } catch {
      // A browser without memory has the links.
    }
    for (const link of document.links) {
      const [, page, anchor] = link.getAttribute("href").match(/^([^:?#]*\.html)(?:#(.*))?$/) || [];
      const own = link.dataset.highlight ? `highlight=${encodeURIComponent(link.dataset.highlight)}&` : "";
      if (page && (!anchor || asks(anchor))) link.href = `${page}#${own}${text}`;
    }
  };
  if (said()) keep(said());
  return { said, keep };
})();
