"use strict";
for (const name of ["units", "theme"]) {
  for (const input of document.querySelectorAll(`input[name="${name}"]`)) {
    input.addEventListener("change", () => { document.documentElement.dataset[name] = input.value; });
    if (input.checked) document.documentElement.dataset[name] = input.value;
  }
}
