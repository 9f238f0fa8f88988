"""The colours of all pictures of studies: M. Okabe, K. Ito (2008), told apart by colour-blind readers."""

BLUE, RED, GREEN, PURPLE, ORANGE, GREY = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "0.25"
