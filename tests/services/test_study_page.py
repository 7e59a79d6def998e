"""The human study's store and HTTP interface, without a browser."""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from services.db.engine import Database
from services.db.migrate import upgrade
from services.db.studies import StudyAnswer, StudyParticipant
from services.web.study_app import create_study_app
from services.web.study_create import PictureFile, StudyEntry, check_names, create_study, list_studies
from services.web.study_pictures import entries_from_photographs
from services.web.study_store import StudyStore
from simcore.errors import InputError
from simcore.parameters import FabricParameters

FABRIC = FabricParameters(1000.0, 800.0, 300.0, 5e-5, 4e-5, 4e-5, 0.2)


def png(grey: int) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(np.full((16, 16), grey, np.uint8)).save(stream, format="PNG")
    return stream.getvalue()


def entries(count: int = 6, repeats: int = 2) -> list[StudyEntry]:
    return [
        StudyEntry(
            f"fabric {k}",
            FABRIC,
            tuple(
                PictureFile(r, scene, "image/png", png(20 * k + r))
                for r in range(repeats)
                for scene in ("hanging", "stretch")
            ),
        )
        for k in range(count)
    ]


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    database = Database(f"sqlite:///{tmp_path / 'study.db'}")
    upgrade(database)
    yield create_study(database, "pilot", entries(), triplets=12, shared=3, seed=4)
    database.close()


@pytest.fixture
def client(store: StudyStore) -> Iterator[TestClient]:
    with TestClient(create_study_app(store)) as client:
        yield client


def test_a_participant_from_beginning_to_end(client: TestClient, store: StudyStore) -> None:
    assert client.get("/study").json() == {"name": "pilot", "questions": 12, "fabrics": 6}
    begun = client.post("/participants", json={"experience": "some"})
    assert begun.status_code == 201
    who = begun.json()["participant"]
    for position in range(12):
        state = client.get(f"/participants/{who}").json()
        assert state == {"questions": 12, "answered": position, "next": position}
        question = client.get(f"/participants/{who}/questions/{position}").json()
        assert question["chosen"] is None
        for side in ("reference", "left", "right"):
            assert len(question[side]) == 2  # hanging and stretch of one repeat
            picture = client.get("/" + question[side][0])
            assert picture.headers["content-type"] == "image/png"
            Image.open(io.BytesIO(picture.content)).verify()
        body = {"chosen": "left" if position % 2 else "right", "milliseconds": 1500}
        assert client.put(f"/participants/{who}/answers/{position}", json=body).status_code == 204
    assert client.get(f"/participants/{who}").json()["next"] is None
    answers = store.answers(simulated=False)
    assert len(answers) == 12
    assert store.answers(simulated=True) == []
    assert {a.triplet.reference for a in answers} == set(range(6))
    exported = store.export()
    assert [e.position for e in exported] == list(range(12))
    assert all(e.experience == "some" and e.milliseconds == 1500 and not e.simulated for e in exported)
    assert all(e.chosen in (e.left, e.right) and e.reference not in (e.left, e.right) for e in exported)


def test_a_changed_mind_replaces_the_answer(client: TestClient, store: StudyStore) -> None:
    who = client.post("/participants", json={}).json()["participant"]
    for chosen in ("left", "left", "right"):
        client.put(f"/participants/{who}/answers/0", json={"chosen": chosen, "milliseconds": 10})
    (exported,) = store.export()
    assert exported.chosen == exported.right
    assert exported.changes == 1
    assert client.get(f"/participants/{who}/questions/0").json()["chosen"] == "right"


def test_participants_differ_but_share_some_questions(client: TestClient, store: StudyStore) -> None:
    rows = []
    for _ in range(3):
        participant = store.participant(client.post("/participants", json={}).json()["participant"])
        assert participant is not None
        rows.append({(r, min(a, b), max(a, b)) for r, a, b, *_ in participant.questions})
    assert len(set.intersection(*rows)) >= 3
    assert rows[0] != rows[1]


def test_what_does_not_exist_or_makes_no_sense(client: TestClient) -> None:
    assert client.get("/participants/part_0").status_code == 404
    assert client.get("/pictures/pic_0").status_code == 404
    who = client.post("/participants", json={}).json()["participant"]
    assert client.get(f"/participants/{who}/questions/99").status_code == 404
    assert client.get(f"/participants/{who}/questions/-1").status_code == 404
    put = f"/participants/{who}/answers/"
    assert client.put(put + "0", json={"chosen": "both"}).status_code == 422
    assert client.put(put + "0", json={"chosen": "left", "milliseconds": -1}).status_code == 422
    assert client.put(put + "99", json={"chosen": "left"}).status_code == 404
    assert client.post("/participants", json={"experience": "guru"}).status_code == 422
    assert client.post("/participants", json={"name": "Ada"}).status_code == 422


def test_the_page_loads_nothing_from_elsewhere(client: TestClient) -> None:
    page = client.get("/")
    assert "default-src 'self'" in page.headers["content-security-policy"]
    for asset in ("static/study.css", "static/study.js"):
        assert asset in page.text
        assert client.get("/" + asset).status_code == 200
    assert "http://" not in page.text
    assert "https://" not in page.text


def test_people_are_told_all_that_is_stored_of_them(client: TestClient) -> None:
    """A column that is added needs its words on the page, or stands for nothing about a person."""
    told = {
        StudyParticipant: {"created_at": "when you begin", "experience": "what you say here"},
        StudyAnswer: {
            "chosen": "your answers",
            "answered_at": "when you gave them",
            "milliseconds": "how long they took",
            "changes": "how often you changed your mind",
        },
    }
    nothing = {"number", "id", "study_number", "place", "simulated", "questions", "participant_number", "position"}
    page = " ".join(client.get("/").text.split())
    sentence = page[page.index("<p>Kept are") : page.index("nothing else about you")]
    for table, words in told.items():
        assert {column.key for column in table.__table__.columns} - nothing == set(words)
        assert all(part in sentence for part in words.values())


def test_the_same_answer_again_keeps_the_time_that_it_took(store: StudyStore) -> None:
    person = store.add_participant()
    left, right = person.questions[0][1:3]
    for chosen, milliseconds in ((left, 1500), (left, 10), (right, 700)):
        store.answer(person, 0, chosen, milliseconds)
        (row,) = store.export()
        assert (row.milliseconds, row.changes) == ((1500, 0) if chosen == left else (700, 1))


def test_studies_are_listed_with_people_and_simulated_observers_apart(store: StudyStore) -> None:
    store.add_participant()
    person, machine = store.add_participant(), store.add_participant(simulated=True)
    for participant in (person, machine, machine):
        store.answer(participant, 0, participant.questions[0][1], 5)
    (row,) = list_studies(store.database)
    assert (row["begun"], row["participants"], row["answers"]) == (2, 1, 1)
    assert (row["simulated_observers"], row["simulated_answers"]) == (1, 1)
    assert len(store.answers(simulated=True)) == 1
    assert store.answers(simulated=True)[0].simulated


def test_pictures_of_another_study_are_not_shown(store: StudyStore) -> None:
    other = create_study(store.database, "other", entries(), triplets=12, shared=0, seed=0)
    foreign = other.pictures(0, 0)[0]
    assert other.picture(foreign) is not None
    assert store.picture(foreign) is None
    stranger = other.add_participant()
    assert store.participant(stranger.id) is None


@pytest.mark.parametrize(
    ("count", "triplets", "shared", "seed", "code"),
    [
        (2, 20, 0, 0, "fabrics_too_few"),
        (6, 11, 0, 0, "triplets_few"),
        (6, 61, 0, 0, "triplets_many"),
        (6, 12, 13, 0, "triplets_shared"),
        (6, 12, 0, -1, "seed_out_of_range"),
    ],
)
def test_unusable_studies(count: int, triplets: int, shared: int, seed: int, code: str, store: StudyStore) -> None:
    with pytest.raises(InputError) as caught:
        create_study(store.database, "x", entries(count), triplets=triplets, shared=shared, seed=seed)
    assert caught.value.code == code
    assert len(list_studies(store.database)) == 1


def test_a_study_needs_names_and_pictures(store: StudyStore) -> None:
    twice = [*entries(5), entries(1)[0]]
    with pytest.raises(InputError, match="name of its own"):
        create_study(store.database, "x", twice, triplets=12, shared=0, seed=0)
    bare = [*entries(5), StudyEntry("bare", None, ())]
    with pytest.raises(InputError, match="no pictures of bare"):
        create_study(store.database, "x", bare, triplets=12, shared=0, seed=0)


@pytest.mark.parametrize(("study", "shown"), [("study_0", "study_0"), ("\udcff", r"\\udcff")])
def test_unknown_study(store: StudyStore, study: str, shown: str) -> None:
    """Bytes that are no text are none, too."""
    with pytest.raises(InputError, match=rf"no study '{shown}' in this database: .*study list") as caught:
        StudyStore(store.database, study)
    assert caught.value.code == "study_unknown"


def test_what_no_participant_can_say_is_not_recorded(store: StudyStore) -> None:
    with pytest.raises(InputError, match="one of none, some, professional") as caught:
        store.add_participant(experience="guru")
    assert caught.value.code == "experience_unknown"
    person = store.add_participant()
    reference, left, _, *_ = person.questions[0]
    for position, chosen, told, code in (
        (12, left, "no question 12", "question_unknown"),
        (-1, left, "no question -1", "question_unknown"),
        (0, reference, f"question 0 does not offer fabric {reference}", "answer_not_offered"),
    ):
        with pytest.raises(InputError, match=told) as caught:
            store.answer(person, position, chosen, 10)
        assert caught.value.code == code
    assert store.export() == [] and list_studies(store.database)[0]["begun"] == 1


def png_header(width: int, height: int) -> bytes:
    """A few bytes that promise a grey picture of this size."""
    content = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    start = b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + content + struct.pack(">I", zlib.crc32(content))
    return start + struct.pack(">I", 0) + b"IDAT" + struct.pack(">I", zlib.crc32(b"IDAT"))


@pytest.mark.parametrize(
    ("content", "code", "told"),
    [
        (png_header(10_001, 10_000), "photograph_too_large", "more than 100 megapixels; scale it down"),
        (png_header(60_000, 60_000), "photograph_too_large", "more than 100 megapixels; scale it down"),
        (b"no picture", "photograph_unreadable", "not a usable picture"),
        (png(7)[:-30], "photograph_unreadable", "not a usable picture"),
        (b"", "photograph_unreadable", "not a usable picture"),
    ],
)
def test_a_photograph_that_cannot_be_shown_is_named(content: bytes, code: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "cotton").mkdir()
    (tmp_path / "cotton" / "front.png").write_bytes(content)
    with warnings.catch_warnings(), pytest.raises(InputError, match=rf"cotton/front\.png: {told}") as caught:
        warnings.simplefilter("error")  # the library's own word of a large picture is not passed on
        entries_from_photographs(tmp_path)
    assert caught.value.code == code


def test_what_is_sent_is_never_sent_back_and_never_long(client: TestClient) -> None:
    secret = "wizard" * 100
    answer = client.post("/participants", json={"experience": secret})
    assert answer.status_code == 422 and "wizard" not in answer.text and len(answer.content) < 300
    assert client.post("/participants", json={"experience": "x" * 20_000}).status_code == 413
    for path in ("/participants/%00", "/pictures/%00", f"/pictures/{'p' * 100}"):
        assert client.get(path).status_code == 422


@pytest.mark.parametrize("name", ["", "n" * 201, "a\0b"])
def test_names_that_the_database_cannot_hold_are_refused(name: str, store: StudyStore) -> None:
    for study, first in ((name, "a"), ("pilot", name)):
        with pytest.raises(InputError) as caught:
            check_names(study, [first, "b"])
        assert caught.value.code == "study_names"


def test_photographs_of_one_stem_are_all_shown(tmp_path: Path, store: StudyStore) -> None:
    for fabric in "abcd":
        (tmp_path / fabric).mkdir()
        for name in ("front.jpg", "front.png", f"{'long' * 30}1.png", f"{'long' * 30}2.png"):
            Image.new("RGB", (8, 8)).save(tmp_path / fabric / name)
    made = create_study(store.database, "photos", entries_from_photographs(tmp_path), triplets=8, shared=1, seed=0)
    assert [len(made.pictures(place, 0)) for place in range(4)] == [4] * 4


def test_pictures_of_other_kinds_look_as_they_are(tmp_path: Path) -> None:
    """Sixteen bits are scaled, what is transparent lies on white."""
    for fabric in "ab":
        (tmp_path / fabric).mkdir()
        ramp = np.tile(np.linspace(0, 65535, 64).astype(np.uint16), (64, 1))
        Image.fromarray(ramp).save(tmp_path / fabric / "a.png")
        Image.new("RGBA", (64, 64), (0, 0, 0, 0)).save(tmp_path / fabric / "b.png")
    ramp_shown, clear_shown = (
        np.asarray(Image.open(io.BytesIO(shown.content))) for shown in entries_from_photographs(tmp_path)[0].pictures
    )
    assert abs(float(ramp_shown.mean()) - 127.5) < 3.0 and ramp_shown[:, 0].max() < 20
    assert clear_shown.min() > 250


@pytest.mark.parametrize(
    ("strange", "told"),
    [
        ("loose.jpg", r"loose\.jpg is in no fabric's subfolder: move it into one"),
        ("IMG_1.HEIC", r"IMG_1\.HEIC is in no fabric's subfolder"),
        ("cotton/more/b.jpg", "cotton: more is a folder, .*: move its photographs up into cotton"),
        ("cotton/more/", "cotton: more is a folder"),
    ],
)
def test_photographs_in_the_wrong_place_are_refused(strange: str, told: str, tmp_path: Path) -> None:
    for place in ("cotton/a.jpg", strange):
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        if place.endswith("/"):
            (tmp_path / place).mkdir()
        else:
            Image.new("RGB", (8, 8)).save(tmp_path / place, format="JPEG")
    with pytest.raises(InputError, match=told) as caught:
        entries_from_photographs(tmp_path)
    assert caught.value.code == "photograph_kind"


def test_what_is_hidden_or_left_behind_is_no_fabric(tmp_path: Path) -> None:
    for place in ("cotton", ".git", "__MACOSX", "@eaDir", "cotton/@eaDir", "cotton/.thumbnails", ".trash"):
        (tmp_path / place).mkdir()
        Image.new("RGB", (8, 8)).save(tmp_path / place / "a.jpg")
    for name in (".hidden.jpg", "Thumbs.db", "notes.txt"):
        (tmp_path / name).touch()
    (cotton,) = entries_from_photographs(tmp_path)
    assert cotton.name == "cotton" and len(cotton.pictures) == 1


@pytest.mark.parametrize(
    ("files", "code"), [(["a.jpg", "IMG_1.HEIC"], "photograph_kind"), ([], "study_pictures_missing")]
)
def test_photographs_are_not_left_out_without_a_word(tmp_path: Path, files: list[str], code: str) -> None:
    (tmp_path / "cotton").mkdir()
    for name in (*files, ".DS_Store", "Thumbs.db"):
        Image.new("RGB", (8, 8)).save(tmp_path / "cotton" / name, format="JPEG")
    with pytest.raises(InputError, match="cotton") as caught:
        entries_from_photographs(tmp_path)
    assert caught.value.code == code
