"""What is shown at the terminal and in files: symbols, units, tables, colours, verdicts."""

from processing.number_text import (
    NOT_KNOWN,
    decimals,
    interval,
    judged_number,
    percent,
    plain,
    power,
    signed,
    signed_percent,
    with_uncertainty,
)
from rig.terminal import palette
from rig.terminal.latex import latex_rows, latex_table
from rig.terminal.printing import (
    ProgressLine,
    Table,
    answer,
    harmless_text,
    loud,
    one_json_object,
    plain_values,
    print_json_line,
    print_line,
    print_tables,
    say,
    screen_width,
    translated_file_errors,
)
from rig.terminal.quantities import (
    SOURCES,
    QuantityDisplay,
    balance_numbers,
    balance_panels,
    balance_style,
    balance_table,
    law_parameters,
    quantity,
    unit_of,
)
from rig.terminal.verdict import Verdict, failures, print_verdicts
