//! Conversations with a board of nothing but the controller, honest and hostile ones.

use super::*;
use crate::link::message::{decode_reply, encode_command};
use crate::link::{Deframer, MAX_FRAME, encode, frame};
use crate::{Controller, Sample, Table};
use proptest::prelude::*;

/// A board of nothing but the controller and a stage that follows it.
struct Board {
    controller: Controller,
    settings: Settings,
    config: Config,
    table: Table,
    record: crate::Record,
    stream: Option<(Fields, Profile)>,
    /// Starts and ends of streams.
    exchanges: u32,
    saves: u32,
    reboots: u32,
}

impl Board {
    fn new() -> Self {
        let settings = Settings::default();
        let config = Config::build(&settings).unwrap();
        let mut board = Self {
            controller: Controller::new(),
            settings,
            config,
            table: Table::EMPTY,
            record: crate::Record::default(),
            stream: None,
            exchanges: 0,
            saves: 0,
            reboots: 0,
        };
        board.tick();
        board
    }

    fn tick(&mut self) {
        let sample = Sample {
            gauge: [self.config.gauge_code(0, 0.0); 3],
            monitor: [self.config.monitor_code(0, 0.0); 3],
            overrun: false,
        };
        self.record = self.controller.tick(&self.config, &self.table, &sample);
    }
}

impl Device for Board {
    fn identity(&self) -> Identity {
        Identity { serial: [7; 12], ..Identity::default() }
    }
    fn status(&self) -> Status {
        let (tick, flags) = (self.record.tick, self.record.flags.0);
        Status { tick, flags, stream: self.stream, ..Status::default() }
    }
    fn counters(&self) -> Counters {
        Counters::default()
    }
    fn crash(&self) -> Crash {
        Crash::default()
    }
    fn settings(&self) -> &Settings {
        &self.settings
    }
    fn fits(&self, _: &Settings) -> Result<(), crate::SettingsError> {
        Ok(())
    }
    fn configure(&mut self, settings: &Settings, config: Config) -> Result<u32, Refusal> {
        self.settings = settings.clone();
        self.config = config;
        Ok(self.record.tick + 1)
    }
    fn write_table(&mut self, _: usize, _: &[f32]) -> Result<(), Refusal> {
        Ok(())
    }
    fn use_table(&mut self, _: usize) -> Result<u32, Refusal> {
        Ok(self.record.tick + 1)
    }
    fn stream(&mut self, stream: Option<(Fields, Profile)>) -> u32 {
        self.stream = stream;
        self.exchanges += 1;
        self.record.tick + 1
    }
    fn reboot(&mut self, _: bool) {
        self.reboots += 1;
    }
    async fn control(&mut self, command: crate::Command) -> Result<u32, Refusal> {
        let result = self.controller.command(&self.config, command);
        self.tick();
        result.map(|()| self.record.tick).map_err(Refusal::Control)
    }
    async fn save(&mut self) -> Result<(u32, u8), Refusal> {
        self.saves += 1;
        Ok((self.saves, 0))
    }
}

fn ask(session: &mut Session, board: &mut Board, command: &Command) -> Reply {
    let (mut request, mut answer) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    let bytes = encode_command(&mut request, 77, command).unwrap();
    let request = frame::decode(bytes).unwrap();
    let length = ready(session.handle(board, &request, 0, &mut answer)).unwrap();
    let answer = frame::decode(&answer[..length]).unwrap();
    assert_eq!(answer.sequence, 77);
    decode_reply(&answer).unwrap()
}

#[test]
fn a_probe_that_is_refused_changes_nothing_and_one_that_is_not_no_more_than_it_must() {
    let (mut session, mut board) = (Session::new(), Board::new());
    let generator = crate::GeneratorSettings::Hold { position_um: 1.0, blend_s: 0.1 };
    let mut probe = |board: &mut Board, profile| {
        let fields = Fields::RECORDING;
        let exchanges = board.exchanges;
        let command = Command::Probe { axis: 0, generator, fields, profile };
        (ask(&mut session, board, &command), board.exchanges - exchanges)
    };
    board.stream(Some((Fields::RECORDING, Profile::Exact)));
    for profile in [Profile::Exact, Profile::Packed] {
        let (reply, exchanges) = probe(&mut board, profile);
        let refusal = Refusal::Control(crate::Refusal::NotArmed);
        assert_eq!((reply, exchanges), (Reply::Refused(refusal), 0), "{profile:?}");
    }
    board.controller.command(&board.config, crate::Command::Arm).unwrap();
    board.tick();
    let (reply, exchanges) = probe(&mut board, Profile::Packed);
    let refusal = Refusal::Control(crate::Refusal::StillArming);
    assert_eq!((reply, exchanges), (Reply::Refused(refusal), 0));
    while board.controller.state() == crate::State::Arming {
        board.tick();
    }
    let start = board.controller.command(&board.config, crate::Command::Start { axes: 1 });
    assert_eq!(start, Err(crate::Refusal::NothingStaged), "the refused one has left nothing");
    for (profile, expected) in [(Profile::Exact, 0), (Profile::Packed, 1)] {
        let (reply, exchanges) = probe(&mut board, profile);
        assert!(matches!(reply, Reply::Done { .. }), "{reply:?}");
        assert_eq!(exchanges, expected, "{profile:?}");
    }
}

#[test]
fn commands_are_acknowledged_with_what_took_effect() {
    let (mut session, mut board) = (Session::new(), Board::new());
    let mut settings = Settings::default();
    settings.axes[2].feedback.proportional_v_per_um = 2.0;
    let digest = Config::build(&settings).unwrap().digest();
    let reply = ask(&mut session, &mut board, &Command::SetSettings(settings.clone()));
    assert!(matches!(reply, Reply::Configured { digest: d, .. } if d == digest));
    let reply = ask(&mut session, &mut board, &Command::ReadSettings);
    assert_eq!(reply, Reply::Settings(settings));
    let on = Command::StreamOn { fields: Fields::RECORDING, profile: Profile::Packed };
    let reply = ask(&mut session, &mut board, &on);
    assert!(matches!(reply, Reply::Streaming { sample_bytes: 28, .. }));
    assert!(matches!(ask(&mut session, &mut board, &Command::Save), Reply::Saved { .. }));
    assert!(matches!(ask(&mut session, &mut board, &Command::Arm), Reply::Done { .. }));
    assert_eq!(ask(&mut session, &mut board, &Command::Save), Reply::Refused(Refusal::NotParked));
    assert_eq!(
        ask(&mut session, &mut board, &Command::RebootToDfu),
        Reply::Refused(Refusal::NotParked)
    );
    assert_eq!(
        ask(&mut session, &mut board, &Command::UseTable { len: 9 }),
        Reply::Refused(Refusal::Armed)
    );
    assert_eq!((session.commands, session.refused, board.saves, board.reboots), (8, 3, 1, 0));
}

#[test]
fn bad_settings_change_nothing() {
    let (mut session, mut board) = (Session::new(), Board::new());
    let digest = board.config.digest();
    let mut settings = Settings::default();
    settings.axes[0].limits.max_v = f32::INFINITY;
    let reply = ask(&mut session, &mut board, &Command::SetSettings(settings));
    let Reply::Refused(Refusal::Settings(bad)) = reply else { panic!("{reply:?}") };
    assert_eq!((bad.axis, bad.field.as_str()), (Some(1), "max_v"));
    assert_eq!((board.config.digest(), &board.settings), (digest, &Settings::default()));
}

#[test]
fn what_would_move_a_drive_at_once_waits_until_it_is_parked() {
    let (mut session, mut board) = (Session::new(), Board::new());
    type Change = fn(&mut Settings);
    let changes: [(&str, Change); 6] = [
        ("at_zero_v", |s| s.axes[1].dac.at_zero_v = -9.0),
        ("at_full_v", |s| s.axes[1].dac.at_full_v = 140.0),
        ("full_code", |s| s.axes[1].dac.full_code = 4_094),
        ("max_v", |s| s.axes[1].limits.max_v = 100.0),
        ("min_um", |s| s.axes[1].limits.min_um = 0.0),
        ("max_um", |s| s.axes[1].limits.max_um = 5.0),
    ];
    assert!(matches!(ask(&mut session, &mut board, &Command::Arm), Reply::Done { .. }));
    for (field, change) in changes {
        let mut settings = Settings::default();
        change(&mut settings);
        let reply = ask(&mut session, &mut board, &Command::SetSettings(settings));
        let Reply::Refused(Refusal::Settings(bad)) = reply else { panic!("{field}: {reply:?}") };
        assert_eq!((bad.axis, bad.field.as_str()), (Some(2), field));
        assert!(bad.unit.ends_with("while not parked: disarm first"), "{}", bad.unit);
    }
    // Wider limits and other gains move nothing.
    let mut settings = Settings::default();
    settings.axes[1].limits.max_um = 18.2;
    settings.axes[1].feedback.proportional_v_per_um = 1.0;
    let reply = ask(&mut session, &mut board, &Command::SetSettings(settings));
    assert!(matches!(reply, Reply::Configured { .. }), "{reply:?}");
    // Parked, all of them are taken.
    let mut board = Board::new();
    for (field, change) in changes {
        let mut settings = Settings::default();
        change(&mut settings);
        let reply = ask(&mut session, &mut board, &Command::SetSettings(settings));
        assert!(matches!(reply, Reply::Configured { .. }), "{field}: {reply:?}");
    }
}

#[test]
fn strangers_are_told_who_answers() {
    let (mut session, mut board) = (Session::new(), Board::new());
    let (mut request, mut answer) = ([0; MAX_FRAME], [0; MAX_FRAME]);
    let mut identity_of = |request: Frame<'_>| {
        let length = ready(session.handle(&mut board, &request, 0, &mut answer)).unwrap();
        let answer = frame::decode(&answer[..length]).unwrap();
        assert_eq!(answer.kind, Kind::Identity);
        Identity::from_bytes(answer.payload).unwrap()
    };
    let bytes = encode(&mut request, Kind::Identify, 1, &[]).unwrap();
    let mut plain = frame::decode(bytes).unwrap();
    plain.schema = 5;
    assert_eq!(identity_of(plain).schema, SCHEMA_HASH);
    let bytes = encode_command(&mut request, 1, &Command::Arm).unwrap();
    let mut other = frame::decode(bytes).unwrap();
    other.schema ^= 1;
    assert_eq!(identity_of(other).serial, [7; 12]);
}

proptest! {
    /// Hostile input: whatever arrives, only whole commands of this schema act, and nothing panics.
    #[test]
    fn hostile_bytes_change_nothing(
        packets in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..64), 0..40),
    ) {
        let (mut session, mut board) = (Session::new(), Board::new());
        let (mut deframer, mut answer) = (Deframer::new(), [0; MAX_FRAME]);
        for packet in packets {
            deframer.push(&packet, |frame| {
                ready(session.handle(&mut board, &frame, 0, &mut answer)).unwrap();
            });
        }
        prop_assert_eq!(session.commands, 0);
        prop_assert_eq!(board.settings, Settings::default());
    }

    /// The same with good checksums around hostile payloads.
    #[test]
    fn hostile_payloads_never_panic(
        payloads in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..64), 0..40),
    ) {
        let (mut session, mut board) = (Session::new(), Board::new());
        let (mut request, mut answer) = ([0; MAX_FRAME], [0; MAX_FRAME]);
        for payload in payloads {
            let bytes = encode(&mut request, Kind::Command, 3, &payload).unwrap();
            let request = frame::decode(bytes).unwrap();
            let length = ready(session.handle(&mut board, &request, 0, &mut answer)).unwrap();
            prop_assert!(frame::decode(&answer[..length]).is_ok());
        }
    }
}
