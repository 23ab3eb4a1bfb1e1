// A picture opens in full size when it is clicked or tapped; another click, or Escape, closes it.
document.addEventListener("click", (event) => {
  const open = document.querySelector(".enlarged");
  if (open) {
    open.remove();
    return;
  }
  const image = event.target.closest(".md-content img");
  if (!image || image.closest("a")) return;
  const overlay = document.createElement("div");
  overlay.className = "enlarged";
  const copy = image.cloneNode();
  copy.removeAttribute("width");
  overlay.appendChild(copy);
  document.body.appendChild(overlay);
});
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") document.querySelector(".enlarged")?.remove();
});
