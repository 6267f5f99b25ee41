"use strict";
document.documentElement.classList.add("js");

for (const range of document.querySelectorAll(".wipe")) {
  const pair = range.closest(".pair");
  const show = () => {
    pair.style.setProperty("--at", range.value + "%");
    range.setAttribute("aria-valuetext", `${range.value} % ${range.dataset.left}`);
  };
  range.addEventListener("input", show);
  show();
}

for (const choice of document.querySelectorAll("input[name=view]")) {
  const apply = () => {
    if (choice.checked) document.documentElement.classList.toggle("beside", choice.value === "beside");
  };
  choice.addEventListener("change", apply);
  apply();
}
