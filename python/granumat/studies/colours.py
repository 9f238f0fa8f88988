"""The colours of all figures of studies, from M. Okabe, K. Ito (2008): colour-blind readers can tell them apart."""

BLUE, RED, GREEN, PURPLE, ORANGE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "0.25"
