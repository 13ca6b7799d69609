"""What is blind: folders whose results are sealed, keys that lie elsewhere, values sealed for their owner."""

from rig.sealing.envelopes import check_installed, disclosed, enclosed, public_key
from rig.sealing.folders import (
    FolderSeal,
    check_folder,
    is_blind,
    open_folder,
    refuse_blind,
    seal_folder,
    seal_over,
)
from rig.sealing.keys import key_path, new_key, stored_key
