//! Commands, refusals and status bits in words, for windows, messages and logs.

use flexstage::link::message::{Command, Refusal};
use flexstage::{Faults, Flags, State};

/// Name of a command as a person would call it.
pub fn command_name(command: &Command) -> &'static str {
    match command {
        Command::Status => "status",
        Command::Counters => "counters",
        Command::Crash => "crash report",
        Command::ReadSettings => "read settings",
        Command::Arm => "arm",
        Command::Disarm => "stop",
        Command::Hold => "hold",
        Command::ClearFaults => "clear faults",
        Command::KeepAlive => "keep alive",
        Command::Stage { .. } => "stage waveform",
        Command::Start { .. } => "start waveform",
        Command::SetSettings(_) => "set settings",
        Command::WriteTable { .. } => "write waveform table",
        Command::UseTable { .. } => "use waveform table",
        Command::StreamOn { .. } => "stream on",
        Command::StreamOff => "stream off",
        Command::Probe { .. } => "probe",
        Command::Save => "save settings",
        Command::Reboot => "restart",
        Command::RebootToDfu => "restart into the loader",
    }
}

/// Why the board refused.
pub fn refusal(why: &Refusal) -> String {
    why.to_string()
}

/// What the controller is doing, in a sentence.
pub fn state_words(flags: Flags) -> &'static str {
    match flags.state() {
        State::Off if flags.is_parked() => "off: drives parked at the safe voltage",
        State::Off => "off: drives are returning slowly to the safe voltage",
        State::Arming => "arming: the loop closes at the measured position",
        State::Run => "running",
        State::Hold => "holding",
        State::Fault => "fault: drives return to the safe voltage; clear the fault to go on",
    }
}

/// One latched fault.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct FaultWords {
    /// Code as documentation and logs name it.
    pub code: &'static str,
    /// What it means and what to do.
    pub words: &'static str,
}

/// Latched faults of a status word.
pub fn faults(flags: Flags) -> Vec<FaultWords> {
    let set = flags.faults();
    Faults::TABLE
        .iter()
        .filter(|(bit, _, _)| set.contains(*bit))
        .map(|&(_, code, words)| FaultWords { code, words })
        .collect()
}

/// Axes (from 1) that have a fault of their own.
pub fn faulted_axes(flags: Flags) -> Vec<usize> {
    (0..flexstage::AXES).filter(|&axis| flags.axis_faulted(axis)).map(|axis| axis + 1).collect()
}

/// All faults of a status word in one line.
pub fn fault_line(flags: Flags) -> String {
    let list: Vec<String> =
        faults(flags).iter().map(|f| format!("{}: {}", f.code, f.words)).collect();
    let axes = faulted_axes(flags);
    let place = match axes.as_slice() {
        [] => String::new(),
        axes => {
            let names: Vec<String> = axes.iter().map(usize::to_string).collect();
            format!(" (axis {})", names.join(", "))
        }
    };
    if list.is_empty() { format!("no code{place}") } else { format!("{}{place}", list.join("; ")) }
}
