"""Okabe and Ito's colours for colour-blind eyes, in an order that reads well on the dark page."""

from protocol.messages import Phase

Colour = int
"""0xRRGGBBAA"""

ORANGE = 0xE69F00FF
SKY = 0x56B4E9FF
GREEN = 0x009E73FF
PURPLE = 0xCC79A7FF
YELLOW = 0xF0E442FF
VERMILLION = 0xD55E00FF
BLUE = 0x3F8FD0FF
"""Okabe and Ito's blue, lighter: theirs is hard to see on black."""
WHITE = 0xE8E8E8FF
GREY = 0x8A929AFF
DIM = 0x4A525AFF

CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, YELLOW, WHITE)
"""The order of the report's figures, so that a vertex has one colour everywhere."""

PHASE_COLOURS = {
    Phase.BABBLE: GREY,
    Phase.ENCODE: SKY,
    Phase.GROUND: GREEN,
    Phase.WALK: YELLOW,
    Phase.REFINE: BLUE,
    Phase.PRACTISE: ORANGE,
    Phase.EVALUATE: PURPLE,
    Phase.DONE: WHITE,
}


def of_index(index: int) -> Colour:
    """The colour of the vertex, actor or line of this number; they come round again after eight."""
    return CYCLE[index % len(CYCLE)]


def faded(colour: Colour, alpha: int) -> Colour:
    """The colour with another opacity, 0..255 (honoured in 2-D views only)."""
    return (colour & 0xFFFFFF00) | alpha


def darker(colour: Colour, share: float) -> Colour:
    """The colour with `share` of its light, for 3-D views, which know no opacity of points."""
    red, green, blue = ((colour >> shift) & 0xFF for shift in (24, 16, 8))
    return (int(red * share) << 24) | (int(green * share) << 16) | (int(blue * share) << 8) | 0xFF
