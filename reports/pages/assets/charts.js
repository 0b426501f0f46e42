// Draws the charts of a page with Vega-Lite: <div class="chart"> and its specification as JSON.
"use strict";
(() => {
  const { html } = stepbench;
  const options = { mode: "vega-lite", renderer: "svg", ast: true, actions: { export: true, source: false, compiled: false, editor: false } };
  // Room for the labels of an axis beside a panel, the narrowest panel that can be read, and room for a legend.
  const BESIDE = 110, LEAST = 230, LEGEND = 260;
  const fit = (chart, room) => {
    if (!chart.concat) return chart;
    const [{ width }] = chart.concat, columns = Math.max(1, Math.min(chart.columns, Math.floor(room / (width + BESIDE))));
    // The legend stands beside the lines where they leave it room.
    const free = room - columns * (width + BESIDE);
    if (room < 600 || free > LEGEND) chart.config.legend.columns = 1;
    if (free > LEGEND) chart.config.legend.orient = "right";
    for (const panel of chart.concat) panel.width = Math.min(width, Math.max(LEAST, room - BESIDE));
    return { ...chart, columns };
  };
  // Rows of a table in CSV. Vega's own reader makes a program of the head, which the policy forbids.
  const rows = (text) => {
    const table = [[]];
    for (const [, cell, end] of text.matchAll(/("(?:""|[^"])*"|[^,\n]*)(,|\n|$)/g)) {
      table[table.length - 1].push(cell[0] === '"' ? cell.slice(1, -1).replaceAll('""', '"') : cell);
      if (end === "\n") table.push([]);
    }
    const [head, ...body] = table.slice(0, -1);
    return body.map((row) => Object.fromEntries(head.map((name, k) => [name, row[k]])));
  };
  const plain = (key, value) => key === "format" && value.type === "csv" ? { ...value, type: "json" } : value;
  const draw = (node) => {
    const place = document.getElementById(node.dataset.chart);
    if (place.dataset.drawn) return;
    place.dataset.drawn = "yes";
    const chart = JSON.parse(node.textContent, plain), data = html("p", { class: "data" }, "Data: ");
    for (const [name, text] of Object.entries(chart.datasets)) {
      const file = `${name}.csv`, href = URL.createObjectURL(new Blob([text], { type: "text/csv" }));
      data.append(html("a", { href, download: file }, file), " ");
      chart.datasets[name] = rows(text);
    }
    window.vegaEmbed(place, fit(chart, place.clientWidth || document.body.clientWidth), options).then(
      (result) => {
        place.view = result.view;
        place.querySelector("summary")?.setAttribute("aria-label", "save this chart");
        // What a menu leaves without data is no fault: from here on only errors (1) are said.
        place.view.logLevel(1);
        place.parentElement.after(data);
      },
      (error) => {
        place.textContent = "This chart cannot be drawn: " + error.message;
        console.error(error);
      });
  };
  // Charts are drawn when they come near the screen, or all of them to be printed.
  const nodes = [...document.querySelectorAll("script[data-chart]")];
  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) {
      near.unobserve(entry.target);
      draw(nodes.find((node) => node.dataset.chart === entry.target.id));
    }
  }, { rootMargin: "600px" });
  for (const node of nodes) near.observe(document.getElementById(node.dataset.chart));
  window.addEventListener("beforeprint", () => nodes.forEach(draw));
})();
