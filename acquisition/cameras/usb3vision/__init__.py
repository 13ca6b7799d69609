"""USB3 Vision cameras over pyusb: any such camera, without a vendor's SDK."""
