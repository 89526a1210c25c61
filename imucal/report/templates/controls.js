"use strict";
for (const input of document.querySelectorAll(".controls input")) {
  input.addEventListener("change", () => { document.documentElement.dataset[input.name] = input.value; });
  // A browser that keeps forms over a reload keeps what the page does not show.
  if (input.defaultChecked) input.checked = true;
}
