"""Laws of the contact: Hertz, friction and elastic moments, decay, period, half-swing map."""
