"""Distance of a number from a printed one, whose digits say how well it is known."""


def units_off(value: float, printed: str) -> float:
    """The distance in units of the last printed digit: up to a half the value rounds to what is printed."""
    digits = printed.strip().lstrip("+-")
    decimals = len(digits.partition(".")[2])
    return float(abs(value - float(printed)) * 10.0**decimals)
