"""A night that chooses its runs itself: measures one, learns from it, chooses the next."""

from rig.deciding.deciding_night import decide_night
