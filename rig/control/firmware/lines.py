"""Lines to and from the host: checksums, repetitions, refusals and the queue of errors.

It runs on MicroPython and, for the simulated controller, on CPython. The format of the lines is documented in
docs/controller.md.
"""

LINE_MAX = 120
REPLAY = 8
ERRORS_MAX = 16


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x1021 if crc & 0x8000 else crc << 1
        table.append(crc & 0xFFFF)
    return table


_TABLE = _crc_table()


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE (polynomial 1021h, start FFFFh); of b"123456789" it is 29B1h."""
    crc = 0xFFFF
    table = _TABLE
    for byte in data:
        crc = ((crc << 8) & 0xFFFF) ^ table[(crc >> 8) ^ byte]
    return crc


class Refused(Exception):
    """A command that is rejected: (code, text) for the reply and the error queue."""


def _spellings(header: str) -> list[str]:
    """All combinations of short and long mnemonics, as in SCPI: LAS:POW?, LASER:POW? ... of LASer:POWer?"""
    query = "?" if header.endswith("?") else ""
    forms = [""]
    for word in header.rstrip("?").split(":"):
        short = "".join([c for c in word if not ("a" <= c <= "z")])
        long = word.upper()
        forms = [
            (f + ":" if f else "") + w for f in forms for w in ([short] if short == long else [short, long])
        ]
    return [f + query for f in forms]


def spelled(pairs):  # type: ignore[no-untyped-def]
    """Dictionary of the actions by all spellings of their headers."""
    return {spelling: action for header, action in pairs for spelling in _spellings(header)}


class Lines:
    """Commands in, replies and events out, through the bytes of the board.

    `token` is empty while there is no session; `_free` are the actions that are allowed without one,
    `_acting` the others. An action is given the command's argument and returns the values of its reply, or
    raises `Refused`.
    """

    def __init__(self, board):  # type: ignore[no-untyped-def]
        self.board = board
        self.token = ""
        self._errors: list[tuple[int, str]] = []
        self._replies: list[tuple[bytes, bytes]] = []
        self._line = b""
        self._overrun = False
        self._free = {}
        self._acting = {}

    def _receive(self, data: bytes) -> None:
        start = 0
        while True:
            end = data.find(b"\n", start)
            if end < 0:
                break
            line = self._line + data[start:end]
            overrun = self._overrun or len(line) > LINE_MAX
            self._line = b""
            self._overrun = False
            start = end + 1
            if overrun:
                self._fail(-363, "Input buffer overrun")
                self._event("NAK")
            else:
                self._take(line)
        self._line += data[start:]
        if len(self._line) > LINE_MAX:
            self._line = b""
            self._overrun = True

    def _take(self, line: bytes) -> None:
        # a line whose end was lost may precede a complete one, so parsing begins at the last tag
        tag_start = line.rfind(b"#")
        if tag_start < 0:
            self._take_typed(line)
            return
        line = line[tag_start:].rstrip(b"\r")
        for earlier_line, reply in self._replies:
            if earlier_line == line:
                # the host repeats a line whose reply was lost: the reply is sent again, and nothing executed
                self.board.write(reply)
                return
        try:
            body, text = line[:-5], line[1:-5].decode()
            valid = line[-5:-4] == b"*" and int(line[-4:], 16) == crc16(body)
            tag, _, command = text.partition(" ")
            valid = valid and 0 < int(tag) < 65536
        except ValueError:  # UnicodeError is one
            valid = False
        if not valid:
            self._fail(-101, "Invalid character or checksum")
            self._event("NAK")
            return
        reply = self._seal("#" + tag + " " + self._do(command, True))
        self._replies.append((line, reply))
        if len(self._replies) > REPLAY:
            self._replies.pop(0)
        self.board.write(reply)

    def _take_typed(self, line: bytes) -> None:
        """Handle a line without tag and checksum, typed by hand, which may query but not act."""
        line = line.strip()
        if not line:
            return
        try:
            command = line.decode()
        except ValueError:
            command = ""
        if command.split(" ")[0].endswith("?"):
            self.board.write((self._do(command, False) + "\r\n").encode())
        else:
            self._fail(-101, "Invalid character or checksum")
            self._event("NAK")

    def _do(self, command: str, trusted: bool) -> str:
        header, _, argument = command.strip().upper().partition(" ")
        try:
            action = self._free.get(header)
            if action is None:
                action = self._acting.get(header)
                if action is None:
                    raise Refused(-113, "Undefined header")
                if not (self.token and trusted):
                    raise Refused(-203, "Command protected; open a session first")
            values: str = action(argument.strip())
        except Refused as refusal:
            code, text = refusal.args
            self._fail(code, text)
            return f'ERR {code},"{text}"'
        return "OK " + values if values else "OK"

    @staticmethod
    def _seal(body: str) -> bytes:
        raw = body.encode()
        return raw + f"*{crc16(raw):04X}\n".encode()

    def _event(self, text: str) -> None:
        self.board.write(self._seal("!" + text))

    def _fail(self, code: int, text: str) -> None:
        if len(self._errors) < ERRORS_MAX:
            self._errors.append((code, text))
        else:
            self._errors[-1] = (-350, "Queue overflow")

    def _next_error(self, _: str) -> str:
        code, text = self._errors.pop(0) if self._errors else (0, "No error")
        return f'{code},"{text}"'
