"""The ways in which inputs and runs fail, and the tests that say what becomes of each."""

import ast
from functools import cache
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent

CLASSES: dict[int, tuple[str, ...]] = {
    1: (
        "empty, magic only, not MCAP",
        "io_damage any_truncation",
        "cli a_bad_log_among_good_ones",
        "wrong_inputs files_that_are_no_logs",
    ),
    2: (
        "no footer or summary (power cut)",
        "io_damage truncated_file missing_summary_loses",
    ),
    3: (
        "torn last chunk, endless length",
        "io_damage truncated_file damaged_length_is_skipped",
    ),
    4: (
        "wrong summary",
        "io_trust index_of_any_bytes summary_that_cannot_be_read",
        "fuzz damaged_logs",
    ),
    5: (
        "wrong CRC of a chunk",
        "io_damage chunk_with_a_wrong_crc",
    ),
    6: (
        "no CRC in the file",
        "io_damage no_crc_is_said",
        "io_trust nothing_can_be_checked_is_said",
    ),
    7: (
        "decompression bomb",
        "io_bombs bombs",
        "io_damage chunks_that_lie",
    ),
    8: (
        "message longer than its chunk",
        "io_damage records_that_overrun",
    ),
    9: (
        "flood of empty records",
        "io_bombs bombs",
        "io_damage records_that_overrun",
    ),
    10: (
        "unknown compression, encoding, schema",
        "io_damage chunks_that_lie",
        "io_trust video",
        "wrong_inputs encodings_that_nobody_knows",
    ),
    11: (
        "a schema unlike the known type",
        "wrong_inputs fields_are_where_the_schema encodings_that_nobody_knows",
        "io_images pixels_of_cdr_stay",
    ),
    12: (
        "CDR cut, big-endian, padded",
        "io_trust cdr_of_any_bytes",
        "io_names big_endian_cdr",
        "io_images the_last_row_may_lack",
        "wrong_inputs fields_are_where_the_schema",
    ),
    13: (
        "corrupt JPEG, PNG, RVL",
        "io_images that_lie_or_are_cut rvl_of_any",
        "io_frames bad_frames",
    ),
    14: (
        "image unlike CameraInfo",
        "io_images another_size_than",
        "io_trust of_another_calibration",
        "io_frames bad_frames",
    ),
    15: (
        "pixel bomb, lying RVL",
        "io_bombs bombs",
        "io_images compressed_images_that_lie",
    ),
    16: (
        "video",
        "io_trust video",
    ),
    17: (
        "CameraInfo missing or wrong",
        "io_intrinsics camera_matrix_that_is_none",
        "checks images_must",
        "io_intrinsics distortion_that_is_not sizes_must_agree",
        "fuzz calibrations_and_calls",
    ),
    18: (
        "extrinsics missing, cyclic",
        "io_extrinsics missing_extrinsics_name",
        "io_pairing tree_chains",
        "io_extrinsics extrinsics_topic_is_column_major",
        "io_log splits_are_one_log_and_share",
    ),
    19: (
        "wrong depth unit",
        "wrong_inputs depth_unit_that_is_wrong",
        "no_traceback what_no_camera_has",
    ),
    20: (
        "depth without measurement",
        "engine every_frame_has_a_row",
        "io_images metres_are_rounded",
    ),
    21: (
        "stamps zero, backward, double",
        "io_frames zero_stamps_fall_back",
        "io_pairing equal_stamps",
    ),
    22: (
        "colour without depth",
        "io_pairing pairs_by_hand",
        "engine every_frame_has_a_row",
    ),
    23: (
        "chunks out of order",
        "io_index random_logs_are_the_same",
        "io_index stamps_out_of_order",
        "io_frames chunks_in_memory_are_bounded",
    ),
    24: (
        "missing, disordered splits",
        "io_names splits_are_ordered",
        "io_trust a_split_without_an_index",
        "io_log splits_are_one_log_and_share",
        "io_names compressed_files",
    ),
    25: (
        "input changed while read",
        "io_trust changes_while_it_is_read cut_while_it_is_scanned",
        "resume another_run_is_refused",
    ),
    26: (
        "configuration changed between runs",
        "resume another_run_is_refused",
        "sharing parts_of_another_run",
    ),
    27: (
        "killed at any instant",
        "resume whatever_system_call_is_the_last random_kills_change_nothing every_system_call",
        "tracks_folder whatever_system_call_is_the_last",
    ),
    28: (
        "disk full, read-only",
        "cli full_disk_is_one_line",
        "resume full_disk_keeps",
        "resume file_system_that_never_makes",
    ),
    29: (
        "two runs in one folder",
        "resume two_runs_never_share",
        "tracks_folder one_at_a_time two_commands_at_once",
    ),
    30: (
        "GPU out of memory",
        "resume too_little_memory",
        "workers device_without_memory",
    ),
    31: (
        "GPU lost, none there",
        "no_traceback platforms_that_are_not_there",
        "workers worker_of_a_device_that_dies",
    ),
    32: (
        "crash in a native decoder",
        "workers frames_on_which_workers_die worker_that_dies_or_stops",
        "native all_kernels_on_mutated_calibrations",
    ),
    33: (
        "a unit that hangs",
        "workers worker_that_dies_or_stops",
        "resume hangs_one_process",
        "io_worst takes_a_bounded_time",
    ),
    34: (
        "more than buffers hold",
        "features_hostile hostile_images",
        "features overflow_is_flagged",
        "detect_surfaces more_obstacles_than",
    ),
    35: (
        "order or batch changes results",
        "engine bytes_depend_on_neither",
        "workers bytes_depend_on",
    ),
    36: (
        "hostile names",
        "no_traceback names_that_are_not_utf8",
        "io_names hostile_topic_names",
        "export_html nothing_from_a_log_is_markup",
    ),
    37: (
        "hostile JSON, TOML",
        "io_bombs bombs",
        "no_traceback configuration_files",
    ),
    38: (
        "Ctrl-C",
        "cli interrupt_is_one_line",
        "workers control_c_ends",
        "resume signals_keep",
    ),
    39: (
        "partial reads, EIO",
        "io_trust partial_reads_and_errors errors_that_pass bad_for_good",
    ),
    40: (
        "locale, paths that are not UTF-8",
        "no_traceback names_that_are_not_utf8 shows_ascii_only",
    ),
}
"""By number: what it is, then a file of tests and parts of the names of tests in it."""


SEEN: dict[str, tuple[str, ...]] = {
    "calibration that no camera has": (
        "fuzz calibrations_and_calls",
        "native all_kernels_on_mutated_calibrations",
        "checks cameras_that_do_not_exist motions_and_units detect_is_not_for_transformations",
    ),
    "killed between the renames of --overwrite": (
        "resume whatever_system_call_is_the_last overwrite_keeps_the_old_results",
        "tracks_folder whatever_system_call_is_the_last that_were_half_moved",
    ),
    "two runs into one folder": (
        "resume two_runs_never_share",
        "tracks_folder one_at_a_time two_commands_at_once",
    ),
    "one worker killed, crashed or stopped": (
        "workers worker_that_dies_or_stops frames_on_which_workers_die",
        "resume hangs_one_process",
    ),
    "Ctrl-C, power cut, exception in log 49 of 50": (
        "resume signals_keep bug_in_the_49th crash_in_the_49th random_kills_change_nothing",
        "workers control_c_ends",
    ),
    "SIGTERM, SIGHUP, SIGKILL; folders that stay": (
        "resume signals_keep lock_of_a_dead_run random_kills_change_nothing",
    ),
    "input truncated or replaced while it is read": (
        "io_trust changes_while_it_is_read cut_while_it_is_scanned",
    ),
    "a chunk missing that the statistics count": (
        "io_trust chunk_that_the_index_counts message_indexes_alone",
        "fuzz frame_lost_in_silence",
    ),
    "bombs; schema text; 60,000 topics": (
        "io_bombs bombs large_bomb",
        "no_traceback truth_file_with_an_image_of_4_gib",
        "io_images what_follows_an_rvl_image",
    ),
    "control characters, names that are not UTF-8": (
        "no_traceback names_that_are_not_utf8",
        "io_trust names_are_printable",
        "io_names hostile_topic_names",
    ),
    "flags and files that ended in tracebacks": (
        "no_traceback flags what_no_camera_has images_in_json platforms_that_are truth_files",
    ),
    "recordings of other drives in one folder": (
        "io_trust numbered_files_are_one_log drive_does_not_take",
    ),
}
"""What reviewers saw fall, each with what shows that it ends well now."""


@cache
def names_in(file: str) -> list[str]:
    tree = ast.parse((TESTS / f"test_{file}.py").read_text(encoding="utf-8"))
    return [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def assert_there(tests: tuple[str, ...]) -> None:
    """Each part is one of a test's name."""
    assert tests
    for group in tests:
        file, *parts = group.split(" ")
        names = [name for name in names_in(file) if name.startswith("test_")]
        assert parts
        for part in parts:
            assert any(part in name for name in names), f"{file}: {part}"


@pytest.mark.parametrize("number", CLASSES)
def test_each_class_has_its_tests(number):
    _, *tests = CLASSES[number]
    assert_there(tuple(tests))


@pytest.mark.parametrize("what", SEEN)
def test_what_fell_has_its_tests(what):
    assert_there(SEEN[what])


def test_the_table_is_whole():
    assert list(CLASSES) == list(range(1, 41))
