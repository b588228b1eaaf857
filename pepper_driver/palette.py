"""Colours of the pictures: Okabe and Ito's palette, told apart by every kind of colour vision.

The red is the paper's; dashes tell it from the other line of its panel.
"""

BLACK, GREEN, ORANGE, BLUE, RED = "#000000", "#009E73", "#E69F00", "#0072B2", "#CC0000"
PINK, SKY, YELLOW, VERMILION = "#CC79A7", "#56B4E9", "#F0E442", "#D55E00"
PALE_BLUE, GREY, SHADE = "#7FBBE0", "#7F7F7F", "#E2E2E2"
