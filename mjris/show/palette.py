"""Colours that stay apart for colour-blind eyes (after Okabe and Ito), shared by pictures and video."""

CLEAR = "#14bd95"
"""Links in line of sight."""
BLOCKED = "#f26b2e"
"""Blocked links."""
ROVER = "#e69f00"
BOARD = "#1b7f5c"
"""Fixed panels."""
STOPS = "#0072b2"
USERS = ("#d6409f", "#56b4e9", "#9c5a2a", "#7a5bd0", "#e0cf1f", "#f2f2f2")
"""Users in turn; more than these share colours."""
RIVALS = {
    "planner": ("#000000", "--"),
    "reference controls": ("#009e73", "-."),
    "best-placed fixed RIS": ("#cc79a7", (0, (8, 2))),
    "fixed RIS": ("#d55e00", (0, (5, 1, 1, 1, 1, 1))),
    "no RIS, best powers": ("#7f7f7f", ":"),
}
"""Policies that an agent is compared with: colours, and lines that stay apart in grey print."""
RANDOM = "#d55e00"
"""Random phases."""


def user_colour(user: int) -> str:
    """Colour of a user as #rrggbb."""
    return USERS[user % len(USERS)]


def rgb(colour: str) -> tuple[int, int, int]:
    """A #rrggbb colour as bytes."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue
