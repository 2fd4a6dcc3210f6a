"use strict";
(function () {
  const paperWidth = 680;
  const plots = Array.from(document.querySelectorAll(".plot"));
  const drawn = new Set();

  function draw(plot) {
    if (drawn.has(plot)) return;
    drawn.add(plot);
    const picture = JSON.parse(document.getElementById(plot.dataset.from).textContent);
    Plotly.newPlot(plot, picture.data, picture.layout, { displayModeBar: false, responsive: true });
  }

  // One after the other, so that the text can be read and scrolled meanwhile.
  function drawNext(index) {
    if (index >= plots.length) return;
    draw(plots[index]);
    setTimeout(drawNext, 0, index + 1);
  }

  function xAxes(plot) {
    return Object.keys(plot._fullLayout).filter((name) => /^xaxis[0-9]*$/.test(name));
  }

  function move(plot, shift, factor) {
    const change = {};
    for (const name of xAxes(plot)) {
      const [low, high] = plot._fullLayout[name].range;
      const middle = (low + high) / 2 + shift * (high - low);
      const half = ((high - low) / 2) * factor;
      change[name + ".range"] = [middle - half, middle + half];
    }
    Plotly.relayout(plot, change);
  }

  function reset(plot) {
    const change = {};
    for (const name of xAxes(plot)) change[name + ".autorange"] = true;
    Plotly.relayout(plot, change);
  }

  const keys = {
    ArrowLeft: (plot) => move(plot, -0.2, 1),
    ArrowRight: (plot) => move(plot, 0.2, 1),
    "+": (plot) => move(plot, 0, 0.5),
    "-": (plot) => move(plot, 0, 2),
    0: reset,
  };

  for (const figure of document.querySelectorAll("figure")) {
    figure.addEventListener("keydown", (event) => {
      const action = keys[event.key];
      if (!action || event.ctrlKey || event.altKey || event.metaKey) return;
      event.preventDefault();
      action(figure.querySelector(".plot"));
    });
  }

  function remembered() {
    try { return localStorage.getItem("bcapscope-theme"); } catch { return null; }
  }

  function choose(theme) {
    document.documentElement.dataset.theme = theme;
    try { localStorage.setItem("bcapscope-theme", theme); } catch { /* files may have no storage */ }
  }

  const choices = Array.from(document.querySelectorAll("input[name=theme]"));
  for (const choice of choices) {
    if (choice.value === remembered()) { choice.checked = true; choose(choice.value); }
    choice.addEventListener("change", () => choose(choice.value));
  }

  window.addEventListener("beforeprint", () => {
    for (const plot of plots) {
      draw(plot);
      Plotly.relayout(plot, { autosize: false, width: paperWidth });
    }
  });
  window.addEventListener("afterprint", () => {
    for (const plot of plots) Plotly.relayout(plot, { autosize: true, width: null });
  });

  drawNext(0);
})();
