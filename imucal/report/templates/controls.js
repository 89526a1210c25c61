"use strict";
for (const input of document.querySelectorAll(".controls input")) {
  input.addEventListener("change", () => { document.documentElement.dataset[input.name] = input.value; });
  // A browser that keeps forms over a reload keeps what the page does not show.
  if (input.defaultChecked) input.checked = true;
}
// A link to a folded section opens it, and paper has everything that is folded.
const folds = [...document.querySelectorAll(".folded")];
const unfold = () => { const fold = location.hash && document.querySelector(`${CSS.escape(location.hash).replace("\\#", "#")} > .folded`); if (fold) fold.open = true; };
addEventListener("hashchange", unfold);
unfold();
let opened = [];
addEventListener("beforeprint", () => { opened = folds.filter((fold) => !fold.open); opened.forEach((fold) => { fold.open = true; }); });
addEventListener("afterprint", () => { opened.forEach((fold) => { fold.open = false; }); });
