// Lets KaTeX show the formulas of a page, which Sphinx writes between \(...\) and \[...\].
document.addEventListener("DOMContentLoaded", () => renderMathInElement(document.body, {throwOnError: false}));
