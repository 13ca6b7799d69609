"""USB3 Vision cameras of any vendor through pyusb, without a vendor's SDK."""
