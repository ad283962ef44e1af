from .bigs_format import BiGSFormat
from .bigs_grasp import read_bigs
from .biotac_slide_csv import read_biotac_slide_csv
from .biotac_sp_csv import GraspTable, read_biotac_sp_csv, read_biotac_sp_dos_csv
from .decoders.anyskin import AnySkinDecoder
from .decoders.decoder import Decoder, DecoderCounts
from .decoders.flexitac import FlexiTacDecoder
from .decoders.letter_array_packets import LetterArrayDecoder, encode_letter_array
from .decoders.m1616 import M1616Decoder
from .decoders.packets import CobsDecoder, encode_packet
from .decoders.paxini import PaXiniDecoder
from .decoders.protocols import PROTOCOLS, decoder_of
from .decoders.robotiq import RobotiqDecoder
from .decoders.text_rows import TextRowsDecoder
from .eflesh_probe import read_eflesh_probe
from .icub_grasp_txt import ICubGraspFrames, read_icub_grasp_txt
from .idx_file import read_idx
from .lerobot_dataset import write_lerobot
from .lerobot_reader import read_lerobot
from .lerobot_touch import add_to_lerobot
from .matrix_files import read_matrices, read_matrix_csv, read_matrix_npy, read_matrix_png
from .matrix_mat import read_mat_variables, read_matrix_mat
from .mcap_reader import read_mcap
from .mcap_recovery import RepairReport, repair_mcap
from .named_csv import read_named_csv
from .pressure_mat_zip import MatFile, pressure_mat_hash, read_pressure_mat_zip
from .recording_files import read_recording, recording_format, write_recording
from .recording_hdf5 import read_hdf5, read_hdf5_head, write_hdf5
from .recording_mcap import McapWriter, write_mcap
from .recording_npz import read_npz, write_npz
from .samples_npz import read_samples_npz
from .sparsh_skin_pickle import read_sparsh_skin
from .uskin_pick_csv import read_uskin_pick
from .wide_csv import read_wide_csv, write_wide_csv
from .xela_log_csv import read_xela_log_csv
from .xela_message import (
    XelaFrame,
    format_xela_message,
    parse_xela_message,
    parse_xela_text,
)
from .xela_messages import read_xela_messages, write_xela_messages

__all__ = [
    "PROTOCOLS",
    "AnySkinDecoder",
    "BiGSFormat",
    "CobsDecoder",
    "Decoder",
    "DecoderCounts",
    "FlexiTacDecoder",
    "GraspTable",
    "ICubGraspFrames",
    "LetterArrayDecoder",
    "M1616Decoder",
    "MatFile",
    "McapWriter",
    "PaXiniDecoder",
    "RepairReport",
    "RobotiqDecoder",
    "TextRowsDecoder",
    "XelaFrame",
    "add_to_lerobot",
    "decoder_of",
    "encode_letter_array",
    "encode_packet",
    "format_xela_message",
    "parse_xela_message",
    "parse_xela_text",
    "pressure_mat_hash",
    "read_bigs",
    "read_biotac_slide_csv",
    "read_biotac_sp_csv",
    "read_biotac_sp_dos_csv",
    "read_eflesh_probe",
    "read_hdf5",
    "read_hdf5_head",
    "read_icub_grasp_txt",
    "read_idx",
    "read_lerobot",
    "read_mat_variables",
    "read_matrices",
    "read_matrix_csv",
    "read_matrix_mat",
    "read_matrix_npy",
    "read_matrix_png",
    "read_mcap",
    "read_named_csv",
    "read_npz",
    "read_pressure_mat_zip",
    "read_recording",
    "read_samples_npz",
    "read_sparsh_skin",
    "read_uskin_pick",
    "read_wide_csv",
    "read_xela_log_csv",
    "read_xela_messages",
    "recording_format",
    "repair_mcap",
    "write_hdf5",
    "write_lerobot",
    "write_mcap",
    "write_npz",
    "write_recording",
    "write_wide_csv",
    "write_xela_messages",
]
