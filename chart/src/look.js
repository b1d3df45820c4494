// Hovering a mark lights up its row everywhere in its article and shows its pictures; without scripts, titles and cards say the same.
const tip = document.getElementById("tip");
const light = (article, row, on) => article.querySelectorAll(`[data-row="${row}"]`).forEach((e) => e.classList.toggle("on", on));
// The page's own hover takes the place of the browser's.
document.querySelectorAll("svg .mark").forEach((mark) => {
  const title = mark.querySelector("title");
  mark.dataset.says = title.textContent;
  title.remove();
});
document.querySelectorAll("article [data-row]").forEach((element) => {
  const article = element.closest("article");
  const row = element.dataset.row;
  element.addEventListener("mouseenter", () => {
    light(article, row, true);
    if (!element.dataset.says) return;
    const text = document.createElement("div");
    text.className = "text";
    text.textContent = element.dataset.says;
    const pair = document.createElement("div");
    pair.className = "pair";
    article.querySelectorAll(`figure[data-row="${row}"] img`).forEach((img) => pair.append(img.cloneNode()));
    tip.replaceChildren(pair, text);
    tip.style.display = "block";
    const at = element.getBoundingClientRect();
    const left = Math.min(at.right + 14, innerWidth - tip.offsetWidth - 10);
    const top = at.bottom + 14 + tip.offsetHeight > innerHeight ? at.top - tip.offsetHeight - 14 : at.bottom + 14;
    tip.style.left = `${Math.max(10, left)}px`;
    tip.style.top = `${Math.max(10, top)}px`;
  });
  element.addEventListener("mouseleave", () => {
    light(article, row, false);
    tip.style.display = "none";
  });
});
