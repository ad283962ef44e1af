from .bigs_format import BiGSFormat
from .bigs_grasp import read_bigs
from .biotac_slide_csv import read_biotac_slide_csv
from .dataframe import dataframe_to_recording
from .decoders.anyskin import AnySkinDecoder
from .decoders.decoder import Decoder, DecoderCounts
from .decoders.flexitac import FlexiTacDecoder
from .decoders.letter_array_packets import LetterArrayDecoder, encode_letter_array
from .decoders.lines import LinesDecoder
from .decoders.m1616 import M1616Decoder
from .decoders.packets import CobsDecoder, encode_packet
from .decoders.paxini import PaXiniDecoder
from .decoders.protocols import PROTOCOLS, decoder_of
from .decoders.robotiq import RobotiqDecoder
from .decoders.text_rows import TextRowsDecoder
from .eflesh_probe import read_eflesh_probe
from .lerobot_dataset import write_lerobot
from .lerobot_reader import read_lerobot
from .lerobot_touch import add_to_lerobot
from .mcap_reader import read_mcap
from .mcap_recovery import RepairReport, repair_mcap
from .recording_files import read_recording, write_recording
from .recording_hdf5 import read_hdf5, write_hdf5
from .recording_mcap import McapWriter, write_mcap
from .samples_npz import read_samples_npz
from .sparsh_skin_pickle import read_sparsh_skin
from .uskin_pick_csv import read_uskin_pick

__all__ = [
    "PROTOCOLS",
    "AnySkinDecoder",
    "BiGSFormat",
    "CobsDecoder",
    "Decoder",
    "DecoderCounts",
    "FlexiTacDecoder",
    "LetterArrayDecoder",
    "LinesDecoder",
    "M1616Decoder",
    "McapWriter",
    "PaXiniDecoder",
    "RepairReport",
    "RobotiqDecoder",
    "TextRowsDecoder",
    "add_to_lerobot",
    "dataframe_to_recording",
    "decoder_of",
    "encode_letter_array",
    "encode_packet",
    "read_bigs",
    "read_biotac_slide_csv",
    "read_eflesh_probe",
    "read_hdf5",
    "read_lerobot",
    "read_mcap",
    "read_recording",
    "read_samples_npz",
    "read_sparsh_skin",
    "read_uskin_pick",
    "repair_mcap",
    "write_hdf5",
    "write_lerobot",
    "write_mcap",
    "write_recording",
]
