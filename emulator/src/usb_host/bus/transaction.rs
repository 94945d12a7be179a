//! One transaction at a time: token, data, handshake, and what it means for its transfer (USB 2.0 8.5).

use super::{Host, MAX_PACKET};
use crate::periph::usb::{Handshake, Usb};
use crate::time::Time;
use crate::usb_host::transfer::{Completion, Pipe, Stage, Status, Transfer};

impl Host {
    fn toggle(&mut self, pipe: Pipe) -> &mut bool {
        if let Some(i) = self.toggles.iter().position(|t| t.0 == pipe) {
            return &mut self.toggles[i].1;
        }
        self.toggles.push((pipe, false));
        &mut self.toggles.last_mut().expect("just pushed").1
    }

    /// Bulk data toggles start over (SET_CONFIGURATION).
    pub fn reset_toggles(&mut self) {
        self.toggles.clear();
    }

    pub(super) fn transact(&mut self, index: usize, now: Time, device: &mut Usb) {
        self.bus_free = now;
        let address = self.address;
        let pipe = self.queues[index].0;
        let bulk_toggle = if pipe == Pipe::Control { false } else { *self.toggle(pipe) };
        let Some(t) = self.queues[index].1.front_mut() else { return };
        let endpoint = match pipe {
            Pipe::Control => 0,
            Pipe::In(e) | Pipe::Out(e) => e as usize,
        };
        let toggle = if pipe == Pipe::Control { t.toggle } else { bulk_toggle };
        let mut flipped = false;
        let mut ended = None;
        let mut cleared = None;
        let answer = match t.stage {
            Stage::Setup => device.setup(address, &t.setup).map(|()| {
                t.toggle = true;
                t.stage = match (t.setup[0] & 0x80 != 0, t.want) {
                    (_, 0) => Stage::StatusIn,
                    (true, _) => Stage::DataIn,
                    (false, _) => Stage::DataOut,
                };
            }),
            Stage::DataOut => {
                let packet = &t.data[t.sent..t.want.min(t.data.len()).min(t.sent + MAX_PACKET)];
                device.out(address, endpoint, toggle, packet).map(|()| {
                    self.packets += 1;
                    let whole = packet.len() == MAX_PACKET;
                    t.sent += packet.len();
                    t.toggle = !t.toggle;
                    flipped = true;
                    if t.sent >= t.want {
                        if t.pipe == Pipe::Control {
                            t.stage = Stage::StatusIn;
                            t.toggle = true;
                        } else if !t.zlp || !whole {
                            ended = Some(Status::Done);
                        }
                    }
                })
            }
            Stage::DataIn | Stage::StatusIn => {
                device.token_in(address, endpoint).map(|(sent, data)| {
                    self.packets += 1;
                    if sent != toggle {
                        self.repeats += 1;
                        return;
                    }
                    let short = data.len() < MAX_PACKET;
                    t.toggle = !t.toggle;
                    flipped = true;
                    t.data.extend(data);
                    match (t.stage, t.pipe) {
                        (Stage::StatusIn, _) => {
                            ended = Some(Status::Done);
                            cleared = halt_cleared(&t.setup);
                        }
                        (_, Pipe::Control) if short || t.data.len() >= t.want => {
                            t.stage = Stage::StatusOut;
                            t.toggle = true;
                        }
                        (_, Pipe::In(_)) if short || t.data.len() >= t.want => {
                            ended = Some(Status::Done)
                        }
                        _ => {}
                    }
                })
            }
            Stage::StatusOut => {
                device.out(address, 0, true, &[]).map(|()| ended = Some(Status::Done))
            }
        };
        if answer == Handshake::Stall {
            ended = Some(Status::Stall);
        }
        t.silent = if answer == Handshake::Silent { t.silent + 1 } else { 0 };
        if t.silent >= 3 {
            ended = Some(Status::Gone);
        }
        if flipped && pipe != Pipe::Control {
            *self.toggle(pipe) ^= true;
        }
        if let Some(endpoint) = cleared {
            // Whether it was halted or not (USB 2.0 9.4.5).
            self.toggles.retain(|(pipe, _)| *pipe != endpoint);
        }
        if let Some(status) = ended {
            self.complete(index, status, now);
        }
    }

    /// The first transfer of a queue has ended; whether there was one.
    pub(super) fn complete(&mut self, index: usize, status: Status, at: Time) -> bool {
        let (pipe, queue) = &mut self.queues[index];
        let Some(Transfer { id, data, .. }) = queue.pop_front() else { return false };
        self.completions.push_back(Completion { id, pipe: *pipe, status, data, at });
        true
    }
}

/// The bulk pipe to an endpoint that a CLEAR_FEATURE(ENDPOINT_HALT) names.
fn halt_cleared(setup: &[u8; 8]) -> Option<Pipe> {
    match setup {
        [0x02, 1, 0, 0, address, 0, 0, 0] if address & 0x80 != 0 => Some(Pipe::In(address & 0x0f)),
        [0x02, 1, 0, 0, address, 0, 0, 0] => Some(Pipe::Out(*address)),
        _ => None,
    }
}
