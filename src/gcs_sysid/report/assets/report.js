// Draws the figures of a report. Data come from the element #data.
(() => {
  "use strict";

  const PRINTED = 660; // pixels, of a whole line of the printed page
  const figures = charts.unpack(JSON.parse(document.getElementById("data").textContent));
  const holders = [...document.querySelectorAll("[data-figure]")];
  const drawn = charts.show(holders.map((holder) => [holder, figures[holder.dataset.figure]]));
  addEventListener("beforeprint", () => {
    for (const details of document.querySelectorAll("details")) details.open = true;
    for (const figure of drawn) figure.draw(figure.size === "small" || figure.size === "medium" ? PRINTED / 2.1 : PRINTED);
  });
  addEventListener("afterprint", () => drawn.forEach((figure) => figure.draw()));
})();
